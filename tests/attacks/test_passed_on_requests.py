"""Attacks on what one server passes on to another: by its client, and by what pretends to be a home."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import httpx
import pytest
import pytest_asyncio

from app.audit.events.store import Filter
from app.audit.log import Event, EventLog
from app.routing.forwarding import courier
from app.routing.forwarding.hop import HEADER, Hop, sealed
from app.routing.forwarding.target import COOKIE
from app.routing.site_servers import SiteServers
from app.web.admission.access import Role
from tests.app.two_servers import SECOND, TwoServers, two_servers

BUS = "/api/v1/buses/dry-end"
PARAMETER = f"{BUS}/units/1/parameters/6"
WITHIN_S = 30
OK = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\nContent-Type: application/json\r\n\r\n{}"
pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[TwoServers]:
    async with two_servers(tmp_path_factory.mktemp("site")) as site:
        yield site


@pytest_asyncio.fixture(loop_scope="module")
async def site(served: TwoServers) -> TwoServers:
    served.move(SECOND, served.second.url)
    served.line.written.clear()
    return served


@dataclass
class FalseHome:
    """Whatever has taken the place of a home. ``response`` to every request but a probe; empty: none at
    all."""

    response: bytes = OK
    heads: list[bytes] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)
    responds_to_probes: bool = True
    goes_on: bytes = b""
    """Is sent after the response, without end."""

    @asynccontextmanager
    async def listening(self, site: TwoServers) -> AsyncIterator[None]:
        server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        site.move(SECOND, f"http://127.0.0.1:{port}")
        try:
            yield
        finally:
            server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                head = await reader.readuntil(b"\r\n\r\n")
                if head.startswith(b"GET /healthz"):
                    if self.responds_to_probes:
                        writer.write(OK)
                    continue
                self.heads.append(head)
                self.bodies.append(await _body(reader, head))
                writer.write(self.response)
                while self.goes_on:
                    writer.write(self.goes_on)
                    await writer.drain()
        except (asyncio.IncompleteReadError, ConnectionError, ValueError):
            writer.close()


async def _body(reader: asyncio.StreamReader, head: bytes) -> bytes:
    lower, body = head.lower(), b""
    if b"transfer-encoding: chunked" in lower:
        while size := int(await reader.readline(), 16):
            body += await reader.readexactly(size)
            await reader.readline()
        await reader.readline()
    elif b"content-length: " in lower:
        size = int(lower.partition(b"content-length: ")[2].partition(b"\r\n")[0])
        body = await reader.readexactly(size)
    return body


async def raw(site: TwoServers, request: bytes) -> bytes:
    """Send bytes to the first server; return all that it responds until it closes or has responded."""
    parts = urlsplit(site.first.url)
    reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
    writer.write(request)
    async with asyncio.timeout(WITHIN_S):
        head = await reader.readuntil(b"\r\n\r\n")
    writer.close()
    return head


def head_of(site: TwoServers, first_line: str, *lines: str, role: Role = Role.ENGINEER) -> bytes:
    """A request as a program writes it."""
    authorization = f"Authorization: Bearer {site.tokens[role]}"
    return "\r\n".join((first_line, "Host: here", authorization, *lines, "", "")).encode("latin-1")


# --- by a client -----------------------------------------------------------------------------------


@pytest.mark.parametrize("value", ["", "x", "e30=.00", "A" * 4000, "é"])
async def test_a_forged_hop_is_refused_at_each_server(site: TwoServers, value: str) -> None:
    for at in (site.first, site.second):
        head = {"Lineside-Hop": value.encode("latin-1")}
        refused = await site.program(Role.ENGINEER, at).put(PARAMETER, json={"raw": 70}, headers=head)
        assert refused.status_code == 400
    assert site.line.written == []


async def test_a_hop_proves_nothing_for_another_request_or_method(site: TwoServers) -> None:
    hop = _hop(site.first.servers)
    for method, target in (("PUT", BUS), ("GET", PARAMETER), ("PUT", PARAMETER + "?x=1")):
        value = sealed(hop, site.first.servers._secret, method, target.encode())
        refused = await site.program(Role.ENGINEER, site.second).put(
            PARAMETER, json={"raw": 70}, headers={HEADER: value}
        )
        assert refused.status_code == 400
    assert site.line.written == []


def _hop(servers: SiteServers, age_s: float = 0.0) -> Hop:
    now = float(servers.clock.to_store(servers.monotonic()))
    return Hop("app-1", now - age_s, now, "192.0.2.99", "http", "plant.example")


@pytest.mark.parametrize(("age_s", "status"), [(0.0, 200), (3.0, 503), (-3600.0, 200), (3600.0, 503)])
async def test_the_time_on_the_way_counts(site: TwoServers, age_s: float, status: int) -> None:
    """A server that holds a command up makes it late, and none can make it younger than it is."""
    value = sealed(_hop(site.first.servers, age_s), site.first.servers._secret, "PUT", PARAMETER.encode())
    program = site.program(Role.ENGINEER, site.second)
    sent = await program.put(PARAMETER, json={"raw": 70}, headers={HEADER: value})
    assert sent.status_code == status
    assert len(site.line.written) == (status == 200)


async def test_no_one_else_names_the_client(site: TwoServers) -> None:
    made_up = {"X-Forwarded-For": "198.51.100.9", "X-Forwarded-Host": "evil.example"}
    refused = await site.program(Role.VIEWER).put(PARAMETER, json={"raw": 70}, headers=made_up)
    assert refused.status_code == 403
    found: list[Event] = []
    async with asyncio.timeout(60):
        while not found:  # the event follows the response
            found, _ = await site.second.services[EventLog].page(Filter(kind="access_refused"), 5)
    assert found[0]["origin"] == "127.0.0.1"
    assert (await site.first.services[EventLog].page(Filter(kind="access_refused"), 5))[0] == []


async def test_a_foreign_page_is_refused_also_by_way_of_another_server(site: TwoServers) -> None:
    """The home compares the origin with the name under which the person reached the first server."""
    browser = site.browser(Role.ENGINEER)
    own = await browser.put(PARAMETER, json={"raw": 70}, headers={"Origin": site.first.url})
    assert own.status_code == 200
    for origin in ("http://evil.example", site.second.url, "null"):
        foreign = await browser.put(PARAMETER, json={"raw": 71}, headers={"Origin": origin})
        assert (foreign.status_code, foreign.json()["code"]) == (403, "foreign_origin")
    assert site.line.written == [(1, 6, 70)]


@pytest.mark.parametrize(
    "cookie", ["http://evil.example", "../..", "app-9", "x" * 3000, "here", "%0d%0aSet-Cookie:%20a=b", "a b"]
)
async def test_a_forged_home_cookie_leads_nowhere(site: TwoServers, cookie: str) -> None:
    async with FalseHome().listening(site):
        site.move("app-1", site.first.url)
        browser = site.browser(Role.VIEWER)
        signed_in = "; ".join(f"{name}={value}" for name, value in browser.cookies.items())
        browser.cookies.clear()
        shown = await browser.get("/account", headers={"Cookie": f"{signed_in}; {COOKIE}={cookie}"})
    assert shown.status_code == 200
    assert "set-cookie" not in shown.headers


@pytest.mark.parametrize(
    "target",
    [
        "/bus/dry-end/../../users",
        "/bus/dry-end/..%2f..%2fusers",
        "/bus/dry-end%2f..%2f..%2fusers",
        "/units/dry-end/1?next=//evil.example",
        "/bus/dry-end//evil.example",
        "/bus/dry-end;x=%0d%0aLineside-Hop:%20y",
        "http://evil.example/bus/dry-end",
    ],
)
async def test_a_path_goes_to_the_home_as_it_is_and_nowhere_else(site: TwoServers, target: str) -> None:
    home = FalseHome()
    async with home.listening(site):
        await raw(site, head_of(site, f"GET {target} HTTP/1.1"))
    for head in home.heads:
        method, path, version = head.partition(b"\r\n")[0].split(b" ")
        assert (method, version) == (b"GET", b"HTTP/1.1")
        assert path in (target.encode(), target.removeprefix("http://evil.example").encode())
        assert head.lower().count(b"lineside-hop:") == 1


SMUGGLED = b"PUT /smuggled HTTP/1.1\r\nHost: here\r\n\r\n"


@pytest.mark.parametrize(
    ("lines", "body"),
    [
        (("Content-Length: 4", "Transfer-Encoding: chunked"), b"0\r\n\r\n" + SMUGGLED),
        (("Transfer-Encoding: chunked", "Transfer-Encoding: identity"), b"0\r\n\r\n" + SMUGGLED),
        (("Transfer-Encoding: xchunked",), b"0\r\n\r\n" + SMUGGLED),
        (("Transfer-Encoding:\x0bchunked",), b"0\r\n\r\n" + SMUGGLED),
        (("Content-Length: 5", "Content-Length: 50"), b"hello" + SMUGGLED),
        (("Content-Length: +5",), b"hello" + SMUGGLED),
        (("Transfer-Encoding: chunked",), b"5\r\nhello\r\n0\r\nX: y\r\n\r\n" + SMUGGLED),
        (("Transfer-Encoding: chunked",), b"2;a=\n\r\nhi\r\n0\r\n\r\n" + SMUGGLED),
        (("Content-Length: 5", "Idempotency-Key: a\nLineside-Hop: b"), b"hello" + SMUGGLED),
        (("Content-Length: 5", "Connection: Authorization"), b"hello" + SMUGGLED),
        (("Content-Length: 5", "Expect: 100-continue"), b"hello" + SMUGGLED),
    ],
)
async def test_a_request_is_one_request_at_the_home(
    site: TwoServers, lines: tuple[str, ...], body: bytes
) -> None:
    home = FalseHome()
    async with home.listening(site):
        await raw(site, head_of(site, f"PUT {PARAMETER} HTTP/1.1", *lines) + body)
        # The home would have a second one by now: both came in one piece.
        await site.program(Role.VIEWER).get(BUS)
    assert all(head.startswith((b"PUT " + PARAMETER.encode(), b"GET ")) for head in home.heads)
    assert not any(b"smuggled" in each for each in (*home.heads, *home.bodies))
    for head in home.heads:
        lower = head.lower()
        assert lower.count(b"transfer-encoding:") + lower.count(b"content-length:") <= 1
        assert b"authorization: bearer" in lower


# --- by a home --------------------------------------------------------------------------------------


async def test_what_a_home_may_not_set_does_not_reach_the_browser(site: TwoServers) -> None:
    response = (
        b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\nContent-Type: text/html\r\n"
        b"Set-Cookie: lineside_session=stolen\r\nSet-Cookie: __Host-lineside_session=stolen\r\n"
        b"Content-Security-Policy: default-src *\r\nAccess-Control-Allow-Origin: *\r\n"
        b"Clear-Site-Data: *\r\nLocation: https://evil.example/\r\nHX-Redirect: //evil.example\r\n"
        b"Service-Worker-Allowed: /\r\n\r\nok"
    )
    async with FalseHome(response).listening(site):
        shown = await site.browser(Role.VIEWER).get("/bus/dry-end")
    assert shown.text == "ok"
    assert shown.headers.get_list("set-cookie") == [
        f"{COOKIE}={SECOND}; Max-Age=31536000; Path=/; HttpOnly; SameSite=lax"
    ]
    assert "default-src 'self'" in shown.headers["content-security-policy"]
    unset = ("access-control-allow-origin", "clear-site-data", "location", "hx-redirect")
    assert not any(name in shown.headers for name in (*unset, "service-worker-allowed"))


@pytest.mark.parametrize(
    "response",
    [
        b"nonsense\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Type: a\rSet-Cookie: lineside_session=x\r\nContent-Length: 0\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\nok",
        b"HTTP/1.1 200 OK\r\nX: " + b"x" * 500_000 + b"\r\n\r\n",
    ],
)
async def test_a_response_that_is_none(site: TwoServers, response: bytes) -> None:
    home = FalseHome(response)
    async with home.listening(site):
        shown = await site.program(Role.VIEWER).get(BUS)
        assert (shown.status_code, shown.json()["code"]) == (503, "home_away")
        command = await site.program(Role.ENGINEER).put(PARAMETER, json={"raw": 70})
        assert (command.status_code, command.json()["code"]) == (504, "unverified")
    assert [head.split()[0] for head in home.heads] == [b"GET", b"PUT"], "nothing is sent twice"
    assert "set-cookie" not in shown.headers


async def test_a_home_that_never_responds(site: TwoServers) -> None:
    """It accepts connections, as a halted process does: a page states it, and of a command, which is sent
    once, the result is open."""
    home = FalseHome(b"", responds_to_probes=False)
    async with asyncio.timeout(WITHIN_S), home.listening(site):
        shown = await site.program(Role.VIEWER).get(BUS)
        assert (shown.status_code, shown.json()["code"]) == (503, "home_away")
        command = await site.program(Role.ENGINEER).put(PARAMETER, json={"raw": 70})
    assert (command.status_code, command.json()["outcome"]) == (504, "unverified")
    assert [head.split()[0] for head in home.heads] == [b"GET", b"PUT"]


async def test_a_home_that_responds_without_end(site: TwoServers, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(courier, "MAX_RESPONSE_BYTES", 1_000_000)
    endless = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\nContent-Type: text/csv\r\n\r\n"
    home = FalseHome(endless, goes_on=b"1000\r\n" + b"x" * 4096 + b"\r\n")
    async with asyncio.timeout(WITHIN_S), home.listening(site):
        with pytest.raises(httpx.RemoteProtocolError):
            await site.program(Role.VIEWER).get(BUS)


async def test_a_client_has_few_requests_under_way(site: TwoServers, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(courier, "PROBE_AFTER_S", 5.0)
    async with FalseHome(b"", responds_to_probes=False).listening(site):
        program = site.program(Role.VIEWER)
        waiting = [asyncio.create_task(program.get(BUS)) for _ in range(64)]
        refused = await _first_refused(program)
        for task in waiting:
            task.cancel()
        await asyncio.gather(*waiting, return_exceptions=True)
    assert refused.headers["retry-after"]


async def _first_refused(program: httpx.AsyncClient) -> httpx.Response:
    """Of those beside the 64 that wait."""
    async with asyncio.timeout(WITHIN_S):
        while True:
            try:
                response = await program.get(BUS, timeout=0.3)
            except httpx.TimeoutException:
                continue
            if response.status_code == 429:
                return response

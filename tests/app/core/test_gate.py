"""Clients that never finish a request or the reading of its response, on real sockets."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass, field

import pytest
from starlette.types import Receive, Scope, Send

from app.core.server import gate as gate_module
from app.core.server.connections import (
    ARRIVED_AT,
    MAX_OF_ADDRESS,
    MIN_RATE,
    STALL_S,
    WITHIN_S,
    Awaited,
    client_connection,
)
from app.core.server.gate import (
    CLOSING_S,
    MAX_FRAMING_BYTES,
    MAX_HEAD_BYTES,
    MAX_HEADERS,
    MAX_HELD_BYTES,
    MAX_HELD_PARTS,
    MAX_PASSED_OVER_BYTES,
    SLICE_BYTES,
    LoopWatch,
    age_s,
)
from bus.instants import Monotonic
from tests.app.gated import PATIENCE_S, Ends, Port, everything, gated, until

HEAD = b"GET / HTTP/1.1\r\nHost: here\r\n"
GET = HEAD + b"\r\n"
POST = b"POST / HTTP/1.1\r\nHost: here\r\nContent-Length: 100\r\n\r\n"
CHUNKED = POST.replace(b"Content-Length: 100", b"Transfer-Encoding: chunked")


@dataclass
class Site:
    """An app that responds when the test lets it."""

    served: Port = field(init=False)
    go: asyncio.Event = field(default_factory=asyncio.Event)
    requests: int = 0
    bodies: list[bytes] = field(default_factory=list)
    arrivals: list[float] = field(default_factory=list)
    reads_bodies: bool = True
    body: bytes = b"hi"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.requests += 1
        self.arrivals.append(scope["state"][ARRIVED_AT])
        if scope["path"] == "/known":
            client_connection(scope).identify("ann")
        body = b""
        while self.reads_bodies:
            message = await receive()
            if message["type"] == "http.disconnect":
                return
            body += message["body"]
            if not message["more_body"]:
                break
        self.bodies.append(body)
        await self.go.wait()
        length = str(len(self.body)).encode()
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", length)]})
        await send({"type": "http.response.body", "body": self.body})

    async def connect(self, begun: bytes = b"") -> Ends:
        return await self.served.connect(begun)

    def pass_s(self, seconds: float) -> None:
        self.served.pass_s(seconds)

    @property
    def received(self) -> int:
        return self.served.received


@pytest.fixture
async def site() -> AsyncIterator[Site]:
    site = Site()
    site.go.set()
    async with gated(site) as site.served:
        yield site


@pytest.mark.parametrize(
    ("begun", "awaited", "response"),
    [
        (b"", Awaited.FIRST, b""),
        (b"\r\n\r\n", Awaited.FIRST, b""),
        (HEAD, Awaited.HEAD, b"408 Request Timeout"),
        (POST + b"x", Awaited.BODY, b"408 Request Timeout"),
        (GET, Awaited.NEXT, b"200 OK"),
        (GET + b"\r\n", Awaited.NEXT, b"200 OK"),
        (GET + HEAD, Awaited.HEAD, b"408 Request Timeout"),
    ],
)
async def test_an_unfinished_request_is_ended(
    site: Site, begun: bytes, awaited: Awaited, response: bytes
) -> None:
    reader, _ = await site.connect(begun)
    await until(lambda: site.received == len(begun) and site.served.made[0]._pace.awaited is awaited)
    site.served.pass_s_of_port(WITHIN_S[awaited] - 1)
    assert not site.served.made[0].is_over
    site.pass_s(WITHIN_S[awaited] + 1)
    reply = await everything(reader)
    assert response in reply
    if b"408" in response:
        assert b'"code": "too_slow"' in reply
        assert b"Content-Security-Policy" in reply


@pytest.mark.parametrize(
    ("request_line", "header", "status"),
    [
        (b"GET / HTTP/2.0", b"", b"505 HTTP Version Not Supported"),
        (b"GET / HTTP/0.9", b"", b"505 HTTP Version Not Supported"),
        (b"GET / HTTP/1.1", b"Expect: 200-ok\r\n", b"417 Expectation Failed"),
        (b"GET / HTTP/1.1", b"Expect: 100-continue, x\r\n", b"417 Expectation Failed"),
        (b"GET / HTTP/1.1", b"Expect:\r\n", b"200 OK"),
        (b"GET / HTTP/1.0", b"Expect: x\r\n", b"200 OK"),
    ],
)
async def test_what_cannot_be_met_is_refused(
    site: Site, request_line: bytes, header: bytes, status: bytes
) -> None:
    head = request_line + b"\r\nHost: here\r\nConnection: close\r\n" + header
    reader, writer = await site.connect(head + b"\r\n")
    writer.write_eof()
    response = await everything(reader)
    assert response.startswith(b"HTTP/1.1 " + status)
    assert site.requests == (b"200" in status)


async def test_who_waits_for_it_gets_100_continue(site: Site) -> None:
    head = POST.replace(b"Content-Length: 100", b"Expect: 100-Continue\r\nContent-Length: 1")
    reader, writer = await site.connect(head)
    await reader.readuntil(b"HTTP/1.1 100 Continue\r\n\r\n")
    writer.write(b"x")
    assert b"200 OK" in await reader.readuntil(b"hi")


async def test_a_body_that_keeps_the_least_rate_is_waited_for(site: Site) -> None:
    _, writer = await site.connect(POST.replace(b"100", b"1000000"))
    writer.write(b"x" * round(100 * MIN_RATE))
    protocol = site.served.made[0]
    await until(lambda: protocol._pace.received >= 100 * MIN_RATE)
    site.served.pass_s_of_port(WITHIN_S[Awaited.BODY] + 99)
    assert not protocol.is_over
    site.pass_s(WITHIN_S[Awaited.BODY] + 101)
    assert protocol.is_over


async def test_no_client_is_late_while_the_server_works(site: Site) -> None:
    site.go.clear()
    reader, _ = await site.connect(GET + HEAD)
    await until(lambda: site.requests)
    site.pass_s(3600)
    assert not site.served.made[0].transport.is_closing()
    site.go.set()
    assert b"200 OK" in await reader.readuntil(b"hi")


@pytest.mark.parametrize(
    "post",
    [POST + b"x", POST.replace(b"Content-Length: 100", b"Transfer-Encoding: chunked") + b"1\r\nx\r\n"],
    ids=["length", "chunks"],
)
async def test_a_response_before_the_end_of_its_request_is_the_last(site: Site, post: bytes) -> None:
    site.reads_bodies = False
    reader, writer = await site.connect(post)
    response = await everything(reader)
    assert b"200 OK" in response
    assert b"\r\nconnection: close\r\n" in response
    writer.write(b"1\r\nx\r\n" * 20_000 + GET)
    await until(lambda: site.received > 100_000)
    assert site.requests == 1
    assert site.served.made[0]._held_bytes == 0
    site.pass_s(CLOSING_S + 1)
    await until(lambda: not site.served.gates.open)


async def test_a_client_that_sends_on_after_the_last_response_is_dropped(site: Site) -> None:
    site.reads_bodies = False
    reader, writer = await site.connect(POST + b"x")
    await everything(reader)
    with suppress(ConnectionError):
        while site.served.gates.open:
            writer.write(b"x" * 100_000)
            await writer.drain()
    assert site.received <= MAX_PASSED_OVER_BYTES + 1_000_000


@pytest.mark.parametrize(
    "flood",
    [
        b"1;" + b"x" * 2 * MAX_FRAMING_BYTES,
        (b"1;" + b"x" * 98 + b"\r\na\r\n") * (2 * MAX_FRAMING_BYTES // 100),
    ],
    ids=["an extension", "extensions"],
)
async def test_chunks_that_are_no_body_end_their_connection(site: Site, flood: bytes) -> None:
    reader, writer = await site.connect(CHUNKED)
    writer.write(flood)
    assert (await everything(reader)).startswith(b"HTTP/1.1 400")


async def test_empty_lines_before_a_request_are_none_of_it(site: Site) -> None:
    reader, writer = await site.connect(b"\r\n" * 100_000)
    await until(lambda: site.received == 200_000 and not site.served.made[0]._held_bytes)
    assert site.served.made[0]._pace.awaited is Awaited.FIRST
    for _ in range(2):
        writer.write(b"\r\n" + GET)
        assert b"200 OK" in await reader.readuntil(b"hi")


@pytest.mark.parametrize("size", [100_000, 3_000_000])
async def test_a_client_that_does_not_read_is_dropped(site: Site, size: int) -> None:
    site.body = b"x" * size
    reader, writer = await site.connect()
    writer.transport.pause_reading()
    waiting = 0
    while not waiting:
        writer.write(GET)
        await asyncio.sleep(0.01)
        waiting = site.served.made[0].transport.get_write_buffer_size()
    site.pass_s(0)
    site.pass_s(STALL_S + 1)
    assert site.served.made[0].transport.is_closing()
    writer.transport.resume_reading()
    with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
        await reader.readexactly(10**9)


async def test_a_client_that_reads_slowly_but_reads_gets_it_all(site: Site) -> None:
    site.body = b"x" * 3_000_000
    reader, _ = await site.connect(GET)
    got = len((await reader.readuntil(b"\r\n\r\n")) and b"")
    for second in range(200):
        site.pass_s(second)
        got += len(await reader.read(40_000))
    got += len(await reader.readexactly(3_000_000 - got))
    assert got == 3_000_000


@pytest.mark.parametrize(
    "head",
    [
        HEAD + b"X: " + b"a" * 1_000_000,
        HEAD + b"X: " + b"a" * MAX_HEAD_BYTES + b"\r\n\r\n",
        b"GET /" + b"a" * MAX_HEAD_BYTES + b" HTTP/1.1\r\n\r\n",
        HEAD + b"a: b\r\n" * MAX_HEADERS + b"\r\n",
    ],
)
async def test_headers_without_end_are_refused(site: Site, head: bytes) -> None:
    reader, _ = await site.connect(head)
    reply = await everything(reader)
    assert reply.startswith(b"HTTP/1.1 431 ")
    assert site.requests == 0


async def test_a_complete_request_gets_a_response_and_its_body_is_no_header(site: Site) -> None:
    bodies = [b"b" * (2 * MAX_HEAD_BYTES), b"\r\n\r\nGET", b""]
    head = b"POST / HTTP/1.1\r\nHost: here\r\nContent-Length: %d\r\n\r\n"
    reader, _ = await site.connect(b"".join(head % len(body) + body for body in bodies))
    for _ in bodies:
        assert b"200 OK" in await reader.readuntil(b"hi")
    assert site.bodies == bodies


@pytest.mark.parametrize("size", [1, 7, SLICE_BYTES - 1])
async def test_a_request_may_come_in_pieces(site: Site, size: int) -> None:
    sent = POST + b"x" * 100 + GET + CHUNKED + b"2\r\nab\r\n0\r\n\r\n"
    reader, writer = await site.connect()
    for at in range(0, len(sent), size):
        writer.write(sent[at : at + size])
        await asyncio.sleep(0)
    assert (await everything(reader)).count(b"200 OK") == 3
    assert site.bodies == [b"x" * 100, b"", b"ab"]


async def test_requests_by_the_thousand_at_once_wait_in_the_system(site: Site) -> None:
    site.go.clear()
    reader, writer = await site.connect()
    writer.write(GET * 100_000)
    await until(lambda: site.requests)
    await asyncio.sleep(0.1)
    assert site.requests == 1
    assert site.received <= MAX_HELD_BYTES + 300_000
    site.go.set()
    await reader.readuntil(b"hi")


async def test_nonsense_after_a_request_does_not_take_its_response(site: Site) -> None:
    site.go.clear()
    reader, _ = await site.connect(GET + b"\x00\x01 nonsense\r\n\r\n")
    await until(lambda: site.requests)
    site.go.set()
    reply = await everything(reader)
    assert reply.startswith(b"HTTP/1.1 200 OK")
    assert reply.count(b"HTTP/1.1 400") == 1


class PlayedWatch(LoopWatch):
    """Returns the times that the test sets."""

    at = polled_at = Monotonic(0.0)

    def __init__(self) -> None:
        super().__init__(Monotonic(0.0), lambda: self.at)

    @property
    def polled_after(self) -> Monotonic:
        return self.polled_at


@pytest.fixture
def kept_age(monkeypatch: pytest.MonkeyPatch) -> None:
    """The system does not report how long a connection has been open."""
    monkeypatch.setattr(gate_module, "age_s", lambda _: None)


@pytest.mark.usefixtures("kept_age")
async def test_each_request_has_the_time_of_its_first_byte() -> None:
    """Of two in one read the same; of one in two reads that of the first."""
    site, watch = Site(), PlayedWatch()
    site.go.set()
    async with gated(site, watch=watch) as site.served:
        watch.at, watch.polled_at = Monotonic(5000.0), Monotonic(4999.99)
        _, writer = await site.connect(GET)
        await until(lambda: site.requests == 1)
        watch.at, watch.polled_at = Monotonic(5010.0), Monotonic(5006.0)
        writer.write(GET + GET + GET[:9])
        await until(lambda: site.requests == 3)
        watch.at, watch.polled_at = Monotonic(5020.0), Monotonic(5019.99)
        writer.write(GET[9:])
        await until(lambda: site.requests == 4)
    assert site.arrivals == [5000.0, 5006.0, 5006.0, 5006.0]


@pytest.mark.usefixtures("kept_age")
async def test_what_waits_behind_a_request_has_the_time_at_which_it_arrived() -> None:
    """Also what the server has left in the system meanwhile: that has the time since when it was not read."""
    site, watch = Site(), PlayedWatch()
    async with gated(site, watch=watch) as site.served:
        watch.at, watch.polled_at = Monotonic(100.0), Monotonic(99.99)
        post = POST.replace(b"100", b"99999") + b"x" * 99_999
        reader, writer = await site.connect(GET)
        await until(lambda: site.requests == 1)
        watch.at, watch.polled_at = Monotonic(101.0), Monotonic(100.99)
        writer.write(post + GET)
        await until(lambda: site.served.made[0]._held_bytes > MAX_HELD_BYTES)
        watch.at, watch.polled_at = Monotonic(110.0), Monotonic(109.99)
        site.go.set()
        for _ in range(3):
            await reader.readuntil(b"hi")
    assert site.arrivals[:2] == [100.0, 101.0]
    assert site.arrivals[2] in (101.0, 110.0), "110 where the system had given all at once"


async def test_bytes_that_come_alone_wait_together() -> None:
    site = Site()
    async with gated(site) as site.served:
        reader, _ = await site.connect(GET)
        await until(lambda: site.requests)
        for byte in GET * 10:
            site.served.made[0].data_received(bytes([byte]))
        assert len(site.served.made[0]._held) == MAX_HELD_PARTS
        site.go.set()
        for _ in range(11):
            assert b"200 OK" in await reader.readuntil(b"hi")


@pytest.mark.parametrize("age_s", [None, 7.0])
async def test_what_came_before_it_was_accepted_is_as_old_as_its_connection(
    monkeypatch: pytest.MonkeyPatch, age_s: float | None
) -> None:
    monkeypatch.setattr(gate_module, "age_s", lambda _: age_s)
    site, watch = Site(), PlayedWatch()
    site.go.set()
    watch.at, watch.polled_at = Monotonic(50.0), Monotonic(44.0)
    async with gated(site, watch=watch) as site.served:
        reader, writer = await site.connect(GET)
        await reader.readuntil(b"hi")
        watch.at, watch.polled_at = Monotonic(60.0), Monotonic(59.99)
        writer.write(GET)
        await reader.readuntil(b"hi")
    assert site.arrivals == [43.0 if age_s else 44.0, 60.0]


async def test_a_client_that_has_just_connected_does_not_give_way_to_a_burst(site: Site) -> None:
    site.go.clear()
    for _ in range(MAX_OF_ADDRESS):
        await site.connect(GET)
    reader, writer = await site.connect()
    await site.connect(GET)
    site.go.set()
    writer.write(GET)
    assert b"200 OK" in await reader.readuntil(b"hi")


async def test_who_has_signed_in_does_not_give_way_to_strangers(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(WITHIN_S, Awaited.NEXT, PATIENCE_S)  # on a busy machine it would end meanwhile
    reader, writer = await site.connect(GET.replace(b"/ ", b"/known ", 1))
    await reader.readuntil(b"hi")
    for _ in range(MAX_OF_ADDRESS + 1):
        await site.connect()
    assert not site.served.made[0].transport.is_closing()
    writer.write(GET)
    assert b"200 OK" in await reader.readuntil(b"hi")


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (
            b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
            b"400",
        ),
        (b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\nhello", b"400"),
        (b"POST / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked, identity\r\n\r\n0\r\n\r\n", b"400"),
        (b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: -1\r\n\r\n", b"400"),
        (b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 99999999999999999999999\r\n\r\n", b"400"),
        (b"POST / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\nFFFFFFFFFFFFFFFFFF\r\n", b"400"),
        (b"POST / HTTP/1.1\r\nHost : a\r\nContent-Length: 0\r\n\r\n", b"400"),
        (b"POST / HTTP/1.1\r\nHost: a\r\nX: a\nContent-Length: 0\r\n\r\n", b"400"),
        (b"GET / HTTP/1.1\r\nHost: a\r\nX: a\x00b\r\n\r\n", b"400"),
        (b"GET /\xff\xfe HTTP/1.1\r\nHost: a\r\n\r\n", b"400"),
        (b"GET /%ff%00 HTTP/1.1\r\nHost: a\r\n\r\n", b"200"),
        (b"FOO / HTTP/1.1\r\nHost: a\r\n\r\n", b"400"),
        (b"CONNECT evil:80 HTTP/1.1\r\nHost: a\r\n\r\n", b"400"),
        (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"400"),
        (b"GET / HTTP/9.9\r\nHost: a\r\n\r\n", b"400"),
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", b"400"),
    ],
)
async def test_a_malformed_request_is_refused_as_a_problem(
    site: Site, request_: bytes, status: bytes
) -> None:
    reader, writer = await site.connect(request_)
    writer.write_eof()
    reply = await reader.readuntil(b"\r\n\r\n")
    assert reply.startswith(b"HTTP/1.1 " + status)
    assert status == b"200" or b"application/problem+json" in reply


async def test_an_upgrade_to_an_unknown_protocol_is_ignored(site: Site) -> None:
    upgrade = (
        HEAD + b"Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: AAMAAABk\r\n\r\n"
    )
    reader, writer = await site.connect(upgrade)
    assert (await reader.readuntil(b"hi")).startswith(b"HTTP/1.1 200 ")
    writer.write(GET)
    assert b"200 OK" in await reader.readuntil(b"hi")


async def test_a_loop_that_turns_is_seen_to_turn_and_a_stall_is_seen() -> None:
    now = Monotonic(5000.0)
    watch = LoopWatch(Monotonic(4000.0), lambda: now)
    assert (watch.polled_after, watch.earliest()) == (4000.0, 4000.0)
    watch.start()
    try:
        await until(lambda: watch.polled_after == 5000.0)
        assert watch.earliest() == 5000.0
        now = Monotonic(5004.0)
        assert (watch.polled_after, watch.earliest()) == (5000.0, 5000.0)
        await until(lambda: watch.polled_after == 5004.0)
        now = Monotonic(5004.1)
        assert watch.earliest() == 5004.1
    finally:
        watch.stop()


def test_the_system_knows_how_long_a_connection_has_waited_to_be_accepted() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        begun = time.monotonic()
        with socket.create_connection(listening.getsockname()):
            time.sleep(0.2)
            accepted, _ = listening.accept()
            with accepted:
                age = age_s(accepted)
    assert age is not None
    assert 0.1 < age < time.monotonic() - begun + 0.1


def test_without_the_systems_report_nothing_is_assumed() -> None:
    one, other = socket.socketpair()
    with one, other:
        assert age_s(one) is None
    assert age_s(one) is None
    assert age_s(None) is None

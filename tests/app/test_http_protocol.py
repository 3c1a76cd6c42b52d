"""Clients that never finish a request or the reading of its response, on real sockets."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

import pytest
import uvicorn
from starlette.types import Receive, Scope, Send
from uvicorn.server import ServerState

from app.server.admission.refusal_log import RefusalLog
from app.server.admission.turns import LoopTurns
from app.server.connection.client_connection import client_connection
from app.server.connection.connections import MAX_OF_ADDRESS, Connections
from app.server.connection.http import (
    MAX_HEAD_BYTES,
    MAX_HEADERS,
    MAX_PASSED_OVER_BYTES,
    MAX_PIPELINED,
    HttpProtocol,
)
from app.server.connection.pace import MIN_RATE, PROMPT_S, STALL_S, WITHIN_S, Awaited
from app.server.connection.protocol import CLOSING_S

HEAD = b"GET / HTTP/1.1\r\nHost: here\r\n"
GET = HEAD + b"\r\n"
POST = b"POST / HTTP/1.1\r\nHost: here\r\nContent-Length: 100\r\n\r\n"
PATIENCE_S = 30.0
Ends = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@dataclass
class Site:
    """A server of this protocol, and an app that responds when the test lets it."""

    port: int = 0
    protocols: list[HttpProtocol] = field(default_factory=list)
    writers: list[asyncio.StreamWriter] = field(default_factory=list)
    connections: Connections = field(default_factory=Connections)
    turns: LoopTurns = field(default_factory=LoopTurns)
    refusals: RefusalLog = field(default_factory=RefusalLog)
    go: asyncio.Event = field(default_factory=asyncio.Event)
    requests: int = 0
    received: int = 0
    reads_bodies: bool = True
    body: bytes = b"hi"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.requests += 1
        if scope["path"] == "/known":
            client_connection(scope).identify("ann")
        while self.reads_bodies and (message := await receive()).get("more_body"):
            if message["type"] == "http.disconnect":
                return
        await self.go.wait()
        length = str(len(self.body)).encode()
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", length)]})
        await send({"type": "http.response.body", "body": self.body})

    async def connect(self, begun: bytes = b"") -> Ends:
        """A client that has sent ``begun``."""
        known = len(self.protocols)
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        self.writers.append(writer)
        writer.write(begun)
        await until(lambda: len(self.protocols) > known and self.protocols[-1].transport is not None)
        return reader, writer

    def pass_s(self, seconds: float) -> None:
        """What the server does once a second, so much later."""
        now = asyncio.get_running_loop().time() + seconds
        for protocol in self.protocols:
            if protocol.parser is not None:
                protocol.check(now)


async def until(holds: Callable[[], object]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not holds():  # noqa: ASYNC110
            await asyncio.sleep(0.001)


async def everything(reader: asyncio.StreamReader) -> bytes:
    """Until the server closes."""
    return await asyncio.wait_for(reader.read(), PATIENCE_S)


@pytest.fixture
async def site() -> AsyncIterator[Site]:
    async with served() as site:
        yield site


@asynccontextmanager
async def served() -> AsyncIterator[Site]:
    site = Site()
    site.go.set()
    config, state = uvicorn.Config(site, lifespan="off", log_level="critical"), ServerState()

    class Counting(HttpProtocol):
        def data_received(self, data: bytes) -> None:
            site.received += len(data)
            super().data_received(data)

    def protocol() -> HttpProtocol:
        shared = {"open_connections": site.connections, "turns": site.turns, "refusals": site.refusals}
        protocol = Counting(config, state, {}, **shared)
        site.protocols.append(protocol)
        return protocol

    server = await asyncio.get_running_loop().create_server(protocol, "127.0.0.1", 0)
    site.port = server.sockets[0].getsockname()[1]
    yield site
    for writer in site.writers:
        writer.transport.abort()
        with suppress(ConnectionError):
            await writer.wait_closed()
    server.close()
    await until(lambda: all(protocol.parser is None for protocol in site.protocols))


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
    await until(lambda: site.received == len(begun) and site.protocols[0]._pace.awaited is awaited)
    site.pass_s(WITHIN_S[awaited] - 1)
    assert not site.protocols[0]._is_ending
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


async def test_only_a_client_that_knows_it_gets_100_continue(site: Site) -> None:
    expecting = b"Connection: close\r\nExpect: 100-Continue\r\nContent-Length: 1\r\n\r\nx"
    for version, is_sent in ((b"1.0", False), (b"1.1", True)):
        reader, _ = await site.connect(b"POST / HTTP/" + version + b"\r\nHost: here\r\n" + expecting)
        assert ((await everything(reader)).startswith(b"HTTP/1.1 100 Continue")) is is_sent


async def test_a_body_that_keeps_the_least_rate_is_waited_for(site: Site) -> None:
    _, writer = await site.connect(POST.replace(b"100", b"1000000"))
    writer.write(b"x" * round(100 * MIN_RATE))
    protocol = site.protocols[0]
    await until(lambda: protocol._pace.received >= 100 * MIN_RATE)
    site.pass_s(WITHIN_S[Awaited.BODY] + 99)
    assert not protocol._is_ending
    site.pass_s(WITHIN_S[Awaited.BODY] + 101)
    assert protocol._is_ending


async def test_no_client_is_late_while_the_server_works(site: Site) -> None:
    site.go.clear()
    reader, _ = await site.connect(GET + HEAD)
    await until(lambda: site.requests)
    site.pass_s(3600)
    assert not site.protocols[0].transport.is_closing()
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
    parsed = site.protocols[0]._pace.received
    writer.write(b"1\r\nx\r\n" * 20_000 + GET)
    await until(lambda: site.received > 100_000)
    assert (site.requests, site.protocols[0]._pace.received) == (1, parsed)
    assert len(site.protocols[0]._unparsed) == 0
    site.pass_s(CLOSING_S + 1)
    await until(lambda: site.protocols[0].parser is None)


async def test_a_client_that_sends_on_after_the_last_response_is_dropped(site: Site) -> None:
    site.reads_bodies = False
    reader, writer = await site.connect(POST + b"x")
    await everything(reader)
    with suppress(ConnectionError):
        while site.protocols[0].parser is not None:
            writer.write(b"x" * 100_000)
            await writer.drain()
    assert site.received <= MAX_PASSED_OVER_BYTES + 1_000_000


@pytest.mark.parametrize(
    ("begun", "flood"),
    [
        (b"", b"\r\n" * 30_000),
        (GET, b"\r\n" * 30_000),
        (POST.replace(b"Content-Length: 100", b"Transfer-Encoding: chunked"), b"1;" + b"x" * 60_000),
        (
            POST.replace(b"Content-Length: 100", b"Transfer-Encoding: chunked"),
            (b"1;" + b"x" * 98 + b"\r\na\r\n") * 600,
        ),
    ],
    ids=["blank lines at first", "blank lines after a request", "an extension", "extensions"],
)
async def test_bytes_of_neither_head_nor_body_ends_its_connection(
    site: Site, begun: bytes, flood: bytes
) -> None:
    reader, writer = await site.connect(begun)
    writer.write(flood)
    reply = await everything(reader)
    assert reply.count(b"HTTP/1.1") == (begun != b"")
    assert reply == b"" or reply.startswith((b"HTTP/1.1 200", b"HTTP/1.1 400"))


@pytest.mark.parametrize("size", [100_000, 3_000_000])
async def test_a_client_that_does_not_read_is_dropped(site: Site, size: int) -> None:
    site.body = b"x" * size
    reader, writer = await site.connect()
    writer.transport.pause_reading()
    waiting = 0
    while not waiting:
        writer.write(GET)
        await asyncio.sleep(0.01)
        waiting = site.protocols[0].transport.get_write_buffer_size()
    site.pass_s(0)
    site.pass_s(STALL_S + 1)
    assert site.protocols[0].transport.is_closing()
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
    body = b"b" * (2 * MAX_HEAD_BYTES)
    head = b"POST / HTTP/1.1\r\nConnection: close\r\nContent-Length: %d\r\n\r\n" % len(body)
    reader, _ = await site.connect(head + body)
    assert b"200 OK" in await everything(reader)


async def test_requests_by_the_thousand_at_once_are_not_kept(site: Site) -> None:
    reader, _ = await site.connect(GET * 10_000)
    reply = await everything(reader)
    assert site.requests <= MAX_PIPELINED + 1
    assert reply.count(b"200 OK") == site.requests


async def test_nonsense_after_a_request_does_not_take_its_response(site: Site) -> None:
    site.go.clear()
    reader, _ = await site.connect(GET + b"\x00\x01 nonsense\r\n\r\n")
    await until(lambda: site.requests)
    site.go.set()
    reply = await everything(reader)
    assert (reply.count(b"HTTP/1.1"), b"200 OK" in reply) == (1, True)


async def test_the_oldest_of_many_strangers_gives_way_to_the_newest(site: Site) -> None:
    first, _ = await site.connect(POST + b"x")
    others = [await site.connect() for _ in range(MAX_OF_ADDRESS)]
    assert b"503 Service Unavailable" in await everything(first)
    others[-1][1].write(GET)
    assert b"200 OK" in await others[-1][0].readuntil(b"hi")


async def test_a_connection_being_served_gives_way_last(site: Site) -> None:
    site.go.clear()
    served, _ = await site.connect(GET)
    await until(lambda: site.requests)
    for _ in range(MAX_OF_ADDRESS - 1):
        await site.connect()
    for protocol in site.protocols:
        protocol._pace.since -= 2 * PROMPT_S
    await site.connect()
    site.go.set()
    assert b"200 OK" in await served.readuntil(b"hi")


async def test_a_client_that_has_just_connected_does_not_give_way_to_a_burst(site: Site) -> None:
    site.go.clear()
    for _ in range(MAX_OF_ADDRESS):
        await site.connect(GET)
    reader, writer = await site.connect()
    await site.connect(GET)
    site.go.set()
    writer.write(GET)
    assert b"200 OK" in await reader.readuntil(b"hi")


async def test_who_has_signed_in_does_not_give_way_to_strangers(site: Site) -> None:
    reader, writer = await site.connect(GET.replace(b"/ ", b"/known ", 1))
    await reader.readuntil(b"hi")
    for _ in range(MAX_OF_ADDRESS + 1):
        await site.connect()
    assert not site.protocols[0].transport.is_closing()
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

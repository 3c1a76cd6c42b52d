"""Clients of a WebSocket that send more than is read, or read nothing, on real sockets."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass, field

import pytest
import uvicorn
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.server import ServerState

from app.server.admission.refusal_log import RefusalLog
from app.server.admission.turns import LoopTurns
from app.server.connection.client_connection import client_connection
from app.server.connection.connections import Connections
from app.server.connection.http import HttpProtocol
from app.server.connection.pace import STALL_S
from app.server.connection.protocol import CLOSING_S, SLICE_BYTES
from app.server.connection.websocket import (
    MAX_FRAMES_AT_ONCE,
    MAX_MESSAGE_BYTES,
    MAX_UNREAD_BYTES,
    WebSocketProtocol,
)

PATIENCE_S = 30.0
FEED_PATH = "/feed"
HANDSHAKE = (
    "GET {path} HTTP/1.1\r\nHost: here\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)
FIN, CONT, TEXT, CLOSE, PING, PONG = 0x80, 0x0, 0x1, 0x8, 0x9, 0xA
CPU_S = 0.5
"""Of this thread; one chunk of empty frames alone took half a second."""


def frame(opcode: int, payload: bytes = b"", size: int | None = None) -> bytes:
    """Return a frame as a client sends it (RFC 6455, 5.2), masked with zeros; ``size``: the length that it
    claims.
    """
    size = len(payload) if size is None else size
    length = bytes([0x80 | size]) if size < 126 else struct.pack("!BQ", 0x80 | 127, size)
    return bytes([opcode]) + length + b"\0\0\0\0" + payload


@dataclass
class Site:
    """A server with an app that reads and writes a socket when the test lets it."""

    port: int = 0
    connections: Connections = field(default_factory=Connections)
    protocols: list[WebSocketProtocol] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    reads: asyncio.Event = field(default_factory=asyncio.Event)
    connected: asyncio.Event = field(default_factory=asyncio.Event)
    accepts: asyncio.Event = field(default_factory=asyncio.Event)
    accepted: asyncio.Event = field(default_factory=asyncio.Event)
    state: ServerState = field(default_factory=ServerState)
    writers: list[asyncio.StreamWriter] = field(default_factory=list)
    closed: int = 0
    trust: Callable[[], None] = bool

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] == FEED_PATH:
            client_connection(scope).identify("worker")
            self.trust = client_connection(scope).trust
        socket = WebSocket(scope, receive, send)
        self.connected.set()
        await self.accepts.wait()
        with suppress(WebSocketDisconnect):
            await self._read(socket)

    async def _read(self, socket: WebSocket) -> None:
        await socket.accept()
        self.accepted.set()
        await self.reads.wait()
        while (message := await socket.receive())["type"] != "websocket.disconnect":
            self.messages.append(message.get("text", ""))
            if self.messages[-1] == "close":
                await socket.close(4401)
        self.closed = message["code"]

    async def connect(self, path: str = "/live") -> asyncio.StreamReader:
        """A client that has opened its socket."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        self.writers.append(writer)
        writer.write(HANDSHAKE.format(path=path).encode())
        assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
        return reader

    @property
    def protocol(self) -> WebSocketProtocol:
        return self.protocols[-1]


@pytest.fixture
async def site() -> AsyncIterator[Site]:
    site = Site()
    site.reads.set()
    site.accepts.set()

    class Known(WebSocketProtocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            site.protocols.append(self)
            super().connection_made(transport)

    config = uvicorn.Config(
        site, lifespan="off", log_level="critical", ws_per_message_deflate=False, ws=Known
    )
    loop = asyncio.get_running_loop()
    shared = {"open_connections": site.connections, "turns": LoopTurns(), "refusals": RefusalLog()}
    server = await loop.create_server(
        lambda: HttpProtocol(config, site.state, {}, **shared),
        "127.0.0.1",
        0,
    )
    site.port = server.sockets[0].getsockname()[1]
    yield site
    for writer in site.writers:
        writer.transport.abort()
        with suppress(ConnectionError):
            await writer.wait_closed()
    server.close()
    await until_gone(site.state)
    assert site.connections._known == site.connections._strangers == {}


async def until_gone(state: ServerState) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while state.connections or state.tasks:  # noqa: ASYNC110
            await asyncio.sleep(0.001)


async def everything(reader: asyncio.StreamReader) -> bytes:
    """Until the server closes."""
    with suppress(ConnectionError):
        return await asyncio.wait_for(reader.read(), PATIENCE_S)
    return b""


@pytest.mark.parametrize(
    "flood",
    [
        frame(FIN | TEXT, b"{}") * 100_000,
        frame(FIN | TEXT) * 100_000,
        frame(TEXT) + frame(CONT) * 100_000,
        frame(FIN | PING) * 100_000,
        frame(FIN | PING, b"x" * 125) * 10_000,
        frame(FIN | PONG) * 100_000,
    ],
    ids=["messages", "empty messages", "fragments", "empty pings", "pings", "pongs"],
)
async def test_a_flood_of_frames_ends_its_socket(site: Site, flood: bytes) -> None:
    reader = await site.connect()
    begun = time.thread_time()
    site.writers[0].write(flood)
    received = await everything(reader)
    assert time.thread_time() - begun < CPU_S
    assert b"too many messages" in received or received == b""
    assert len(site.messages) <= MAX_FRAMES_AT_ONCE
    assert site.protocol.queue.qsize() <= MAX_FRAMES_AT_ONCE


async def test_a_frame_larger_than_any_message_ends_its_socket_before_it_arrives(site: Site) -> None:
    reader = await site.connect()
    site.writers[0].write(frame(FIN | TEXT, b"x", size=100_000_000))
    received = await everything(reader)
    assert struct.pack("!H", 1009) in received


@pytest.mark.parametrize("early", [frame(FIN | TEXT, b"{}"), frame(FIN | TEXT, b"x", size=100_000_000)])
async def test_frames_before_the_response_to_the_handshake_end_the_connection(
    site: Site, early: bytes
) -> None:
    faults = list[object]()
    asyncio.get_running_loop().set_exception_handler(lambda _, context: faults.append(context))
    site.accepts.clear()
    reader, writer = await asyncio.open_connection("127.0.0.1", site.port)
    site.writers.append(writer)
    writer.write(HANDSHAKE.format(path="/live").encode())
    await site.connected.wait()
    writer.write(early)
    assert await everything(reader) == b""
    site.accepts.set()
    await until_gone(site.state)
    assert (site.messages, faults) == ([], [])


async def test_a_burst_of_handshakes_stands_in_front_of_no_other_sender(site: Site) -> None:
    burst = [await asyncio.open_connection("127.0.0.1", site.port) for _ in range(60)]
    site.writers += [writer for _, writer in burst]
    for _, writer in burst:
        writer.write(HANDSHAKE.format(path="/live").encode())
    reader, writer = await asyncio.open_connection("127.0.0.1", site.port, local_addr=("127.0.0.2", 0))
    site.writers.append(writer)
    writer.write(HANDSHAKE.format(path="/live").encode())
    assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
    assert len(site.protocols) < 40
    for gone, writer in burst[50:]:
        writer.transport.abort()
        await gone.read()
    for reader, _ in burst[:50]:
        assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")


@pytest.mark.parametrize(
    "sent",
    [frame(FIN | CLOSE, struct.pack("!H", 4401)), frame(FIN | PING) * 2000],
    ids=["its Close frame", "a flood"],
)
async def test_what_follows_the_close_of_the_server_ends_the_connection(site: Site, sent: bytes) -> None:
    reader = await site.connect()
    site.protocol.close_timeout = 10 * PATIENCE_S
    site.writers[-1].write(frame(FIN | TEXT, b"close"))
    assert (await reader.readexactly(4))[:1] == bytes([FIN | CLOSE])
    site.writers[-1].write(sent)
    assert await everything(reader) == b""


async def test_fragments_count_together(site: Site) -> None:
    reader = await site.connect()
    half = b"x" * (MAX_MESSAGE_BYTES // 2 + 1)
    site.writers[0].write(frame(TEXT, half) + frame(CONT, half))
    assert struct.pack("!H", 1009) in await everything(reader)


async def test_a_client_that_sends_and_does_not_read_is_dropped(site: Site) -> None:
    await site.connect()
    await site.accepted.wait()
    site.protocol.transport.write(b"x" * 10_000_000)
    assert site.protocol.transport.get_write_buffer_size() > MAX_UNREAD_BYTES
    site.writers[0].write(frame(FIN | PING, b"x"))
    async with asyncio.timeout(PATIENCE_S):
        await site.protocol.loop.create_task(_until_closing(site))


async def test_a_client_that_reads_nothing_is_dropped(site: Site) -> None:
    await site.connect()
    await site.accepted.wait()
    site.protocol.transport.write(b"x" * 10_000_000)
    now = site.protocol.loop.time()
    site.protocol.check(now)
    site.protocol.check(now + STALL_S - 1)
    assert not site.protocol.transport.is_closing()
    site.protocol.check(now + STALL_S + 1)
    assert site.protocol.transport.is_closing()


async def test_a_client_that_has_read_everything_has_its_time_again(site: Site) -> None:
    reader = await site.connect()
    await site.accepted.wait()
    now = site.protocol.loop.time()
    site.protocol.transport.write(b"x" * 10_000_000)
    site.protocol.check(now)
    await asyncio.wait_for(reader.readexactly(10_000_000), PATIENCE_S)
    site.protocol.transport.write(b"x" * 20_000_000)
    site.protocol.check(now + STALL_S + 1)
    assert not site.protocol.transport.is_closing()


async def test_who_does_not_read_the_end_of_a_connection_is_not_waited_for(site: Site) -> None:
    await site.connect()
    await site.accepted.wait()
    now = site.protocol.loop.time()
    site.protocol.transport.write(b"x" * 10_000_000)
    site.protocol.transport.close()
    for later in (0, CLOSING_S):
        site.protocol.check(now + later)
        await asyncio.sleep(0)
        assert site.connections._strangers
    site.protocol.check(now + CLOSING_S + 1)
    async with asyncio.timeout(PATIENCE_S):
        while site.connections._strangers:  # noqa: ASYNC110
            await asyncio.sleep(0.001)


async def test_a_worker_is_not_counted_as_a_stranger(site: Site) -> None:
    await site.connect()
    assert site.connections._known == {}
    await site.connect(FEED_PATH)
    assert list(site.connections._known) == ["worker"]
    assert [len(group) for group in site.connections._strangers.values()] == [1]


async def test_a_worker_may_send_much_at_once_after_hello(site: Site) -> None:
    reader = await site.connect(FEED_PATH)
    site.trust()
    site.writers[0].write(frame(FIN | TEXT, b"{}") * 2000 + frame(FIN | TEXT, b"x" * 1_000_000))
    async with asyncio.timeout(PATIENCE_S):
        while len(site.messages) < 2001:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
    assert not reader.at_eof()


@pytest.mark.soak
async def test_messages_that_the_app_does_not_read_wait_in_the_kernel(site: Site) -> None:
    site.reads.clear()
    await site.connect(FEED_PATH)
    site.trust()
    site.writers[0].write(frame(FIN | TEXT, b"{}") * 500_000)
    await site.accepted.wait()
    async with asyncio.timeout(PATIENCE_S):
        while not site.protocol._unparsed:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
    before = len(site.protocol._unparsed)
    for _ in range(1000):
        await asyncio.sleep(0)
    assert len(site.protocol._unparsed) == before
    assert site.protocol.queue.qsize() <= SLICE_BYTES
    site.writers[0].transport.abort()
    site.reads.set()


@pytest.mark.parametrize(
    "flood",
    [frame(TEXT) + frame(CONT) * 10_000, frame(FIN | PING) * 10_000, frame(FIN | PONG) * 10_000],
    ids=["fragments", "pings", "pongs"],
)
async def test_frames_that_are_no_message_are_few_after_hello_too(site: Site, flood: bytes) -> None:
    reader = await site.connect(FEED_PATH)
    site.trust()
    site.writers[0].write(flood)
    received = await everything(reader)
    assert b"too many messages" in received or received == b""


@pytest.mark.parametrize(
    "begun",
    [
        frame(FIN | TEXT, b"x", size=MAX_MESSAGE_BYTES + 1),
        frame(TEXT, b"x" * MAX_MESSAGE_BYTES) + frame(CONT, b"x"),
    ],
    ids=["a frame", "fragments"],
)
async def test_only_a_small_message_comes_before_hello(site: Site, begun: bytes) -> None:
    reader = await site.connect(FEED_PATH)
    site.writers[0].write(begun)
    assert struct.pack("!H", 1009) in await everything(reader)


async def _until_closing(site: Site) -> None:
    while not site.protocol.transport.is_closing():  # noqa: ASYNC110
        await asyncio.sleep(0.001)

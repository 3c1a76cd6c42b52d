"""Clients of a WebSocket that send more than is read, or read nothing, on real sockets."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass, field

import pytest
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from app.core.server import gate
from app.core.server.connections import client_connection
from app.core.server.gate import MAX_HELD_BYTES, MAX_MESSAGE_BYTES, Gate
from tests.app.gated import PATIENCE_S, Port, everything, gated, until
from tests.attacks import attackers
from tests.attacks.attackers import frame

FEED_PATH = "/feed"
HANDSHAKE = f"GET {{path}} HTTP/1.1\r\nHost: here\r\n{attackers.HANDSHAKE}\r\n"
FIN, CONT, TEXT, CLOSE, PING, PONG = 0x80, 0x0, 0x1, 0x8, 0x9, 0xA
CPU_S = 0.5
"""Of this thread; one chunk of empty frames alone took half a second."""


@dataclass
class Site:
    """A server with an app that reads and writes a socket when the test lets it."""

    served: Port = field(init=False)
    messages: list[str] = field(default_factory=list)
    reads: asyncio.Event = field(default_factory=asyncio.Event)
    connected: asyncio.Event = field(default_factory=asyncio.Event)
    accepts: asyncio.Event = field(default_factory=asyncio.Event)
    accepted: asyncio.Event = field(default_factory=asyncio.Event)
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
        reader, _ = await self.served.connect(HANDSHAKE.format(path=path).encode())
        assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
        return reader

    @property
    def writers(self) -> list[asyncio.StreamWriter]:
        return self.served.writers

    @property
    def gate(self) -> Gate:
        return self.served.made[-1]


@pytest.fixture
async def site() -> AsyncIterator[Site]:
    site = Site()
    site.reads.set()
    site.accepts.set()
    async with gated(site) as site.served:
        yield site


@pytest.mark.parametrize(
    "flood",
    [
        frame(TEXT) + frame(CONT) * 100_000,
        frame(FIN | PING) * 100_000,
        frame(FIN | PING, b"x" * 125) * 10_000,
        frame(FIN | PONG) * 100_000,
        frame(FIN | TEXT, b"x" * (2 * MAX_MESSAGE_BYTES)),
    ],
    ids=["fragments", "empty pings", "pings", "pongs", "a large message"],
)
async def test_a_flood_without_a_message_ends_its_socket(site: Site, flood: bytes) -> None:
    reader = await site.connect()
    begun = time.thread_time()
    site.writers[0].write(flood)
    await everything(reader)
    assert time.thread_time() - begun < CPU_S
    assert site.messages == []


async def test_messages_that_the_app_does_not_read_wait_in_the_system(site: Site) -> None:
    site.reads.clear()
    reader = await site.connect()
    await site.accepted.wait()
    site.writers[0].write(frame(FIN | TEXT, b"{}") * 500_000)
    await until(lambda: site.gate._held_bytes > MAX_HELD_BYTES)
    for _ in range(1000):
        await asyncio.sleep(0)
    assert site.served.received < 1_000_000
    assert not reader.at_eof()
    # Else the app would read a hundred thousand messages until the end of the test.
    site.gate.give_way()
    site.reads.set()


async def test_a_frame_larger_than_any_message_ends_its_socket_before_it_arrives(site: Site) -> None:
    reader = await site.connect()
    site.writers[0].write(frame(FIN | TEXT, b"x", size=100_000_000))
    received = await everything(reader)
    assert struct.pack("!H", 1009) in received


async def test_frames_before_the_response_to_the_handshake_wait_for_it(site: Site) -> None:
    site.accepts.clear()
    reader, writer = await site.served.connect(HANDSHAKE.format(path="/live").encode())
    writer.write(frame(FIN | TEXT, b"early"))
    await site.connected.wait()
    assert site.messages == []
    site.accepts.set()
    assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
    await until(lambda: site.messages == ["early"])


async def test_a_burst_of_handshakes_stands_in_front_of_no_other_sender(site: Site) -> None:
    burst = [await asyncio.open_connection("127.0.0.1", site.served.number) for _ in range(60)]
    site.writers.extend(writer for _, writer in burst)
    for _, writer in burst:
        writer.write(HANDSHAKE.format(path="/live").encode())
    reader, writer = await asyncio.open_connection(
        "127.0.0.1", site.served.number, local_addr=("127.0.0.2", 0)
    )
    site.writers.append(writer)
    writer.write(HANDSHAKE.format(path="/live").encode())
    assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
    assert sum(gate._is_socket for gate in site.served.made) < 40
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
    site.writers[-1].write(frame(FIN | TEXT, b"close"))
    assert (await reader.readexactly(4))[:1] == bytes([FIN | CLOSE])
    site.writers[-1].write(sent)
    await everything(reader)
    await until(lambda: not site.served.gates.open)


async def test_a_client_that_sends_and_does_not_read_is_read_no_more(site: Site) -> None:
    await site.connect()
    await site.accepted.wait()
    site.gate.transport.write(b"x" * 10_000_000)
    written = site.gate.transport.get_write_buffer_size()
    site.writers[0].write(frame(FIN | PING, b"x") * 100)
    await until(lambda: site.gate._held_bytes)
    for _ in range(100):
        await asyncio.sleep(0)
    assert site.gate.transport.get_write_buffer_size() <= written


async def test_a_worker_is_not_counted_as_a_stranger(site: Site) -> None:
    await site.connect()
    assert site.served.gates.connections._known == {}
    await site.connect(FEED_PATH)
    assert list(site.served.gates.connections._known) == ["worker"]
    assert [len(group) for group in site.served.gates.connections._strangers.values()] == [1]


async def test_a_worker_may_send_much_at_once_after_hello(site: Site) -> None:
    reader = await site.connect(FEED_PATH)
    site.trust()
    site.writers[0].write(frame(FIN | TEXT, b"{}") * 2000 + frame(FIN | TEXT, b"x" * 1_000_000))
    async with asyncio.timeout(PATIENCE_S):
        while len(site.messages) < 2001:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
    assert not reader.at_eof()


async def test_a_flood_of_a_worker_in_small_pieces_waits_for_its_turns(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No message comes of a pong, which would hold back what follows until the app has read it."""
    monkeypatch.setattr(gate, "REPORT_EVERY_S", 3600.0)
    await site.connect(FEED_PATH)
    await site.accepted.wait()
    site.trust()
    pieces = 30
    for _ in range(pieces):
        site.gate.data_received(frame(FIN | PONG) * 80)
    assert site.gate._held_bytes > pieces * 240
    site.gate.data_received(frame(FIN | TEXT, b"a report"))
    await until(lambda: site.messages == ["a report"])


@pytest.mark.parametrize(
    "begun",
    [
        frame(FIN | TEXT, b"x" * (2 * MAX_MESSAGE_BYTES), size=3_000_000),
        frame(TEXT, b"x" * MAX_MESSAGE_BYTES) + frame(CONT, b"x" * 1024),
    ],
    ids=["a frame", "fragments"],
)
async def test_only_a_small_message_comes_before_hello(site: Site, begun: bytes) -> None:
    reader = await site.connect(FEED_PATH)
    site.writers[0].write(begun)
    assert await everything(reader) == b""
    assert site.messages == []

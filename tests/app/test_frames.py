"""The fast path out of a WebSocket, on real sockets: uvicorn with our protocol, and a client."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import uvicorn
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket
from uvicorn.server import ServerState
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosedError
from websockets.frames import Frame, Opcode
from websockets.streams import StreamReader

from app.server.admission.refusal_log import RefusalLog
from app.server.admission.turns import LoopTurns
from app.server.connection.client_connection import ClientConnection as Outlet
from app.server.connection.client_connection import client_connection
from app.server.connection.connections import Connection, Connections
from app.server.connection.frames import text_frame
from app.server.connection.websocket import WebSocketProtocol

PATIENCE_S = 30.0


@pytest.mark.parametrize("size", [0, 1, 125, 126, 65_535, 65_536])
def test_a_frame_has_its_complete_payload(size: int) -> None:
    reader = StreamReader()
    reader.feed_data(text_frame(b"x" * size))
    parsing = Frame.parse(reader.read_exact, mask=False, max_size=None)
    with pytest.raises(StopIteration) as parsed:
        next(parsing)
    frame: Frame = parsed.value.value
    assert (frame.fin, frame.opcode, bytes(frame.data)) == (True, Opcode.TEXT, b"x" * size)
    assert reader.buffer == b""


def test_without_the_server_s_offer_nothing_goes_the_short_way() -> None:
    assert not client_connection({"type": "websocket"}).write(text_frame(b"x"))


class Echo:
    """An app of one socket, which the test controls."""

    def __init__(self) -> None:
        self.opened = asyncio.Event()
        self.closed = asyncio.Event()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.socket = WebSocket(scope, receive, send)
        await self.socket.accept()
        self.opened.set()
        while (await self.socket.receive())["type"] != "websocket.disconnect":
            pass
        self.closed.set()

    @property
    def outlet(self) -> Outlet:
        return client_connection(self.socket.scope)


@asynccontextmanager
async def held() -> AsyncIterator[tuple[Echo, ClientConnection]]:
    app, state = Echo(), ServerState()
    config = uvicorn.Config(app, ws_per_message_deflate=False, log_level="critical")
    config.load()
    loop = asyncio.get_running_loop()

    def protocol() -> WebSocketProtocol:
        return WebSocketProtocol(
            config,
            state,
            {},
            connection=Connection("127.0.0.1", None),
            open_connections=Connections(),
            turns=LoopTurns(),
            refusals=RefusalLog(),
        )

    async with await loop.create_server(protocol, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        async with connect(f"ws://127.0.0.1:{port}", compression=None, max_queue=1) as client:
            await app.opened.wait()
            yield app, client


async def test_both_ways_out_keep_their_order() -> None:
    async with held() as (app, client), asyncio.timeout(PATIENCE_S):
        assert app.outlet.write(text_frame(b"1"))
        await app.socket.send_text("2")
        assert app.outlet.write(text_frame("drei \N{EURO SIGN}".encode()))
        assert [await client.recv() for _ in range(3)] == ["1", "2", "drei \N{EURO SIGN}"]


async def test_a_client_that_does_not_read_is_not_written_to() -> None:
    async with held() as (app, client), asyncio.timeout(PATIENCE_S):
        client.transport.pause_reading()
        frame, sent = text_frame(b"x" * 100_000), 0
        while app.outlet.write(frame):
            sent += 1
        protocol = app.outlet
        assert isinstance(protocol, WebSocketProtocol)
        assert 0 < protocol.transport.get_write_buffer_size() <= len(frame)
        assert not app.outlet.write(text_frame(b"late")), "nothing more is kept for it"
        later = asyncio.create_task(app.socket.send_text("the present"))
        client.transport.resume_reading()
        assert {len(await client.recv()) for _ in range(sent)} == {100_000}
        assert await client.recv() == "the present"
        await later
        assert app.outlet.write(frame)


async def test_nothing_is_sent_after_the_close() -> None:
    async with held() as (app, client), asyncio.timeout(PATIENCE_S):
        assert app.outlet.write(text_frame(b"1"))
        await app.socket.close(4401)
        assert not app.outlet.write(text_frame(b"2"))
        assert await client.recv() == "1"
        with pytest.raises(ConnectionClosedError, match="4401"):
            await client.recv()


async def test_nothing_is_sent_to_a_closed_peer() -> None:
    async with held() as (app, client), asyncio.timeout(PATIENCE_S):
        client.transport.abort()
        await app.closed.wait()
        assert not app.outlet.write(text_frame(b"1"))

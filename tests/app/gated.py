"""uvicorn behind gates, in this process: an app is served on a port of its own."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.server import ServerState

from app.cli.server import MAX_MESSAGE_BYTES
from app.core.server.connections import Connections
from app.core.server.gate import RECEIVE_BUFFER_BYTES, Gate, Gates, LoopWatch, Stages
from app.core.server.refusal_log import RefusalLog
from app.core.server.tls import ChooseContext
from bus.instants import monotonic_now

PATIENCE_S = 90.0
Ends = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@dataclass
class Port:
    """A served app: ``made`` are its connections, ended ones too; ``received`` is what they got."""

    gates: Gates
    number: int = 0
    made: list[Gate] = field(default_factory=list)
    writers: list[asyncio.StreamWriter] = field(default_factory=list)
    state: ServerState = field(default_factory=ServerState)
    received: int = 0
    begun_s: float = field(default_factory=lambda: asyncio.get_running_loop().time())

    async def connect(self, begun: bytes = b"", **options: Any) -> Ends:
        """A client that has sent ``begun``, and is accepted."""
        known = len(self.made)
        opening = asyncio.open_connection("127.0.0.1", self.number, **options)
        reader, writer = await asyncio.wait_for(opening, PATIENCE_S)
        self.writers.append(writer)
        writer.write(begun)
        await until(lambda: len(self.made) > known)
        return reader, writer

    def pass_s(self, seconds: float) -> None:
        """What the server does once a second, so much later."""
        self._check(asyncio.get_running_loop().time() + seconds)

    def pass_s_of_port(self, seconds: float) -> None:
        """What the server does so long after the port was opened: no client has waited longer than that,
        however long the test has taken."""
        self._check(self.begun_s + seconds)

    def _check(self, now: float) -> None:
        for gate in tuple(self.gates.open):
            gate.check(now)

    def is_open(self, number: int) -> bool:
        """Whether a connection has not ended."""
        return self.made[number] in self.gates.open and not self.made[number].is_over


async def until(holds: Callable[[], object]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not holds():  # noqa: ASYNC110
            await asyncio.sleep(0.001)


async def everything(reader: asyncio.StreamReader) -> bytes:
    """Until the server closes, however it does."""
    parts = []
    with suppress(ConnectionError):
        while part := await asyncio.wait_for(reader.read(65536), PATIENCE_S):
            parts.append(part)
    return b"".join(parts)


@asynccontextmanager
async def gated(
    app: ASGIApp, *, watch: LoopWatch | None = None, choose_context: ChooseContext | None = None
) -> AsyncIterator[Port]:
    watched = watch or LoopWatch(monotonic_now())
    port = Port(Gates(Connections(), RefusalLog(), watched, choose_context))
    config = uvicorn.Config(
        Stages(app),
        lifespan="off",
        log_level="critical",
        ws="websockets-sansio",
        ws_per_message_deflate=False,
        ws_max_size=MAX_MESSAGE_BYTES,
    )
    options = {"config": config, "server_state": port.state, "app_state": {}}

    class Counted(Gate):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            port.made.append(self)

        def data_received(self, data: bytes) -> None:
            port.received += len(data)
            super().data_received(data)

    def make() -> Gate:
        return Counted(port.gates, HttpToolsProtocol, **options)  # type: ignore[arg-type]

    listening = socket.create_server(("127.0.0.1", 0))
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    server = await asyncio.get_running_loop().create_server(make, sock=listening)
    port.number = listening.getsockname()[1]
    watched.start()
    try:
        yield port
    finally:
        watched.stop()
        server.close()
        for writer in port.writers:
            writer.transport.abort()
            with suppress(OSError):
                await writer.wait_closed()
        await until(lambda: not (port.gates.open or port.state.connections or port.state.tasks))
        assert port.gates.connections._known == port.gates.connections._strangers == {}

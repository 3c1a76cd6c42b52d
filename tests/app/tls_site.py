"""A server of TLS connections in this process: the protocol, its limits, and a small app."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import uvicorn
from starlette.types import Receive, Scope, Send
from uvicorn.server import ServerState

from app.server.admission.refusal_log import RefusalLog
from app.server.admission.turns import ARRIVED_AT, LoopTurns
from app.server.connection.client_connection import client_connection
from app.server.connection.connections import Connections
from app.server.connection.stamping import StampingProtocol
from app.server.connection.websocket import WebSocketProtocol
from app.server.loop_watch import LoopWatch
from app.server.settings import TlsSettings
from app.server.tls.certificate import ServerCertificate
from app.server.tls.connection import TlsConnection
from bus.tls import HTTP_ALPN
from tests.certificates import certificates

PATIENCE_S = 30.0
GET = b"GET / HTTP/1.1\r\nHost: here\r\n\r\n"


@dataclass
class TlsSite:
    """``folder`` has the certificates; the app responds with what it saw of the request."""

    folder: Path
    certificate: ServerCertificate
    port: int = 0
    connections: list[TlsConnection] = field(default_factory=list)
    protocols: list[StampingProtocol] = field(default_factory=list)
    counted: Connections = field(default_factory=Connections)
    refusals: RefusalLog = field(default_factory=RefusalLog)
    turns: LoopTurns = field(default_factory=LoopTurns)
    scopes: list[Scope] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)
    response: bytes = b"hello"
    writers: list[asyncio.StreamWriter] = field(default_factory=list)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.scopes.append({**scope, "certified": client_connection(scope).is_certified()})
        if scope["path"] == "/known":
            client_connection(scope).identify("ann")
        if scope["type"] == "websocket":
            await self._echo(receive, send)
            return
        body = b""
        while (message := await receive()).get("more_body"):
            body += message["body"]
        self.bodies.append(body + message.get("body", b""))
        length = str(len(self.response)).encode()
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", length)]})
        await send({"type": "http.response.body", "body": self.response})

    async def _echo(self, receive: Receive, send: Send) -> None:
        await receive()
        await send({"type": "websocket.accept"})
        while (message := await receive())["type"] == "websocket.receive":
            await send({"type": "websocket.send", "text": message["text"]})

    def make(self) -> TlsConnection:
        protocol = self._make_protocol()
        self.protocols.append(protocol)
        connection = TlsConnection(protocol, self.certificate.context_for, self.turns, self.refusals)
        self.connections.append(connection)
        return connection

    _make_protocol: Any = None

    def client(self) -> ssl.SSLContext:
        """What a browser that trusts the site has."""
        context = ssl.create_default_context(cafile=self.folder / "ca.pem")
        context.set_alpn_protocols([HTTP_ALPN])
        return context

    async def connect(self, context: ssl.SSLContext | None = None, **options: Any) -> Ends:
        """A client after its handshake."""
        tls = {"ssl": context or self.client(), "server_hostname": "localhost", **options}
        return await self._kept(**tls)

    async def plain(self) -> Ends:
        """A client before its handshake."""
        return await self._kept()

    async def _kept(self, **options: Any) -> Ends:
        opening = asyncio.open_connection("127.0.0.1", self.port, **options)
        reader, writer = await asyncio.wait_for(opening, PATIENCE_S)
        self.writers.append(writer)
        return reader, writer

    def pass_s(self, seconds: float) -> None:
        """What the server does once a second, so much later."""
        now = asyncio.get_running_loop().time() + seconds
        for protocol in self.protocols:
            if protocol.parser is not None:
                protocol.check(now)

    @property
    def arrivals(self) -> list[float]:
        return [scope["state"][ARRIVED_AT] for scope in self.scopes]


Ends = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@asynccontextmanager
async def tls_site(folder: Path, *, client_ca: bool = False) -> AsyncIterator[TlsSite]:
    certificates(folder)
    settings = TlsSettings(certificate=folder / "server.pem", key=folder / "server.key")
    if client_ca:
        settings = settings.model_copy(update={"client_ca": folder / "ca.pem"})
    site, watch = TlsSite(folder, ServerCertificate(settings)), LoopWatch()
    config, state = (
        uvicorn.Config(site, lifespan="off", log_level="critical", ws=WebSocketProtocol),
        ServerState(),
    )
    shared = {"open_connections": site.counted, "turns": site.turns, "refusals": site.refusals}
    site._make_protocol = partial(StampingProtocol, config, state, {}, watch=watch, **shared)
    watch.start()
    server = await asyncio.get_running_loop().create_server(site.make, "127.0.0.1", 0)
    site.port = server.sockets[0].getsockname()[1]
    try:
        yield site
    finally:
        watch.stop()
        server.close()
        for writer in site.writers:
            writer.transport.abort()
            with suppress(OSError):
                await writer.wait_closed()
        await server.wait_closed()
        async with asyncio.timeout(PATIENCE_S):
            while any(connection._protocol is not None for connection in site.connections):  # noqa: ASYNC110
                await asyncio.sleep(0.001)

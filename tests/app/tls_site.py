"""An app served by TLS in this process."""

from __future__ import annotations

import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from starlette.types import Receive, Scope, Send

from app.core.server.connections import ARRIVED_AT, client_connection
from app.core.server.settings import TlsSettings
from app.core.server.tls import ServerCertificate
from bus.tls import HTTP_ALPN
from tests.app.gated import Ends, Port, gated
from tests.certificates import certificates

GET = b"GET / HTTP/1.1\r\nHost: here\r\n\r\n"


@dataclass
class TlsSite:
    """``folder`` has the certificates; the app responds with what it saw of the request."""

    folder: Path
    certificate: ServerCertificate
    scopes: list[Scope] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)
    response: bytes = b"hello"
    served: Port = field(init=False)

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

    @property
    def port(self) -> int:
        return self.served.number

    def client(self) -> ssl.SSLContext:
        """What a browser that trusts the site has."""
        context = ssl.create_default_context(cafile=self.folder / "ca.pem")
        context.set_alpn_protocols([HTTP_ALPN])
        return context

    async def connect(self, context: ssl.SSLContext | None = None, **options: Any) -> Ends:
        """A client after its handshake."""
        return await self.served.connect(ssl=context or self.client(), server_hostname="localhost", **options)

    async def plain(self) -> Ends:
        """A client before its handshake."""
        return await self.served.connect()

    @property
    def arrivals(self) -> list[float]:
        return [scope["state"][ARRIVED_AT] for scope in self.scopes]


@asynccontextmanager
async def tls_site(folder: Path, *, client_ca: bool = False) -> AsyncIterator[TlsSite]:
    certificates(folder)
    settings = TlsSettings(certificate=folder / "server.pem", key=folder / "server.key")
    if client_ca:
        settings = settings.model_copy(update={"client_ca": folder / "ca.pem"})
    site = TlsSite(folder, ServerCertificate(settings))
    async with gated(site, choose_context=lambda hello: site.certificate.context_for(hello)) as site.served:
        yield site

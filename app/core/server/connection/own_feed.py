"""The port of this machine on which the server's own workers find it in clear, where HTTPS is served."""

from __future__ import annotations

from starlette.types import ASGIApp, Receive, Scope, Send

from app.core.server.admission.refusal import TLS_REQUIRED

FEED = "/feed"
NOT_HERE = 1008
"""Close code of a WebSocket that may not be opened (RFC 6455, 7.4.1)."""


class OnlyFeed:
    """The app, of which nothing but the feed is served at ``address``: a person signs in by HTTPS."""

    def __init__(self, app: ASGIApp, address: tuple[str, int]) -> None:
        self._app = app
        self._address = address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        is_here = scope.get("server") == self._address
        if not is_here or (scope["type"] == "websocket" and scope["path"] == FEED):
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": NOT_HERE})
        else:
            await TLS_REQUIRED(scope, receive, send)

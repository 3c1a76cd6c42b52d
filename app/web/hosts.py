"""The host names of this server: a browser can be made to request it under any other.

A page whose name is given our address afterwards (DNS rebinding) is of one origin with us for the browser.
Origin alone does not protect a server that responds under every name.
"""

from __future__ import annotations

from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from app.errors import Problem
from app.server.addresses import canonical
from app.web.security import refuse
from bus.messages import Message

LOOPBACK = frozenset({"127.0.0.1", "::1", "localhost"})
OPEN_PATH = "/healthz"
"""Probes request by address, and learn only that the server is up."""


class AllowedHosts:
    """Responds 421 under any name but these; an empty list allows all."""

    def __init__(self, app: ASGIApp, allowed: Collection[str]) -> None:
        self._app = app
        self._allowed = frozenset(canonical(name) for name in allowed)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            problem = self._problem(scope)
            if problem is not None:
                await refuse(scope, receive, send, problem)
                return
        await self._app(scope, receive, send)

    def _problem(self, scope: Scope) -> Problem | None:
        if not self._allowed or scope["path"] == OPEN_PATH:
            return None
        host = host_name(Headers(scope=scope).get("host", ""))
        if host in self._allowed or _is_local(scope, host):
            return None
        return Problem(421, "wrong_host", Message.of("host_not_served", host=host))


def host_name(text: str) -> str:
    """The name in a Host header, without port, in lower case; empty for an invalid one."""
    try:
        return canonical((urlsplit(f"//{text}").hostname or "").rstrip("."))
    except ValueError:
        return ""


def _is_local(scope: Scope, host: str) -> bool:
    """From this machine, under its address: the bus workers of ``serve`` do so."""
    client = (scope.get("client") or ("", 0))[0]
    server = canonical((scope.get("server") or ("", 0))[0])
    return client in (*LOOPBACK, server) and host in (*LOOPBACK, server)

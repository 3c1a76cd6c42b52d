"""Requests that are refused before the app sees them.

A request that changes something, and every WebSocket handshake, must come from our own pages when a
browser sends it: browsers name the page's origin in ``Origin``. One without ``Origin`` is not from a
browser's foreign page (all of them send it with such requests), so scripts need not invent one.
"""

from __future__ import annotations

from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket

from app.errors import Problem
from app.web.arrival import SAFE_METHODS
from app.web.problems import problem_json, refuse_socket
from bus.messages import Message

_DEFAULT_PORTS = {"http": 80, "https": 443, "ws": 80, "wss": 443}


def _authority(scheme: str, netloc: str) -> tuple[str | None, int | None]:
    parts = urlsplit(f"//{netloc}")
    return parts.hostname, parts.port or _DEFAULT_PORTS.get(scheme)


def same_origin(origin: str, host: str) -> bool:
    """Whether an ``Origin`` header names the requested host; ``null`` never does."""
    try:
        parts = urlsplit(origin)
        host_authority = _authority(parts.scheme, host)
        return bool(parts.netloc) and _authority(parts.scheme, parts.netloc) == host_authority
    except ValueError:
        return False


def is_foreign(scope: Scope) -> bool:
    """Whether a foreign page makes a browser send this to change something or to listen."""
    if scope["type"] == "http" and scope["method"] in SAFE_METHODS:
        return False
    headers = Headers(scope=scope)
    origin = headers.get("origin")
    if origin is None:
        return headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none")
    return not same_origin(origin, headers.get("host", ""))


async def refuse(scope: Scope, receive: Receive, send: Send, problem: Problem) -> None:
    """Refuse a request or a WebSocket handshake with a problem before anything else sees it."""
    if scope["type"] == "websocket":
        await refuse_socket(WebSocket(scope, receive, send), problem)
    else:
        await problem_json(problem)(scope, receive, send)


class OwnPagesOnly:
    """Refuses what a foreign page makes a browser send."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket") and is_foreign(scope):
            origin = HTTPConnection(scope).headers.get("origin", "another site")
            problem = Problem(403, "foreign_origin", Message.of("foreign_origin", origin=origin))
            await refuse(scope, receive, send, problem)
            return
        await self._app(scope, receive, send)

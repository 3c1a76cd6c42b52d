"""Headers under which a request could mean two things, or something that this server does not know."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from app.errors import Problem
from app.web.security import refuse
from bus.messages import Message

ONCE = ("host", "authorization", "content-type", "content-encoding", "transfer-encoding", "idempotency-key")
"""Of two, a proxy may have believed one and we the other (RFC 9110, 5.3)."""


class HeaderRules:
    """Refuses a header given twice, a missing Host, and codings of the body that are not decoded here."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        problem = _problem(scope) if scope["type"] in ("http", "websocket") else None
        if problem is not None:
            await refuse(scope, receive, send, problem)
        else:
            await self._app(scope, receive, send)


def _problem(scope: Scope) -> Problem | None:
    headers = Headers(scope=scope)
    for name in ONCE:
        if len(headers.getlist(name)) > 1:
            return Problem(400, "malformed", Message.of("header_twice", name=name.title()))
    if "host" not in headers and scope.get("http_version") == "1.1":
        return Problem(400, "malformed", Message("host_missing"))
    if headers.get("transfer-encoding", "chunked").strip().lower() != "chunked":
        return _unknown_coding("Transfer-Encoding", 501)
    if headers.get("content-encoding", "identity").strip().lower() != "identity":
        return _unknown_coding("Content-Encoding", 415)
    return None


def _unknown_coding(name: str, status: int) -> Problem:
    """RFC 9112, 6.1 and RFC 9110, 15.5.16."""
    return Problem(status, "unsupported_type", Message.of("coding_unknown", name=name))

"""Responses that the server writes itself, for a request that does not get as far as the app, and the headers
by which a browser forbids what no page of ours does."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus

from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

CONTENT_POLICY = (
    "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": CONTENT_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Cache-Control": "no-store",
}
FILE_HEADERS = frozenset({"X-Content-Type-Options", "Cross-Origin-Resource-Policy", "Cache-Control"})
"""Those of `HEADERS` that matter for a static file, which is not a document: the others govern documents,
frames and workers, and a first visit requests some forty files."""
_RAW = {name: (name.lower().encode(), value.encode()) for name, value in HEADERS.items()}
_RAW_OF_ALL, _RAW_OF_FILE = tuple(_RAW.values()), tuple(_RAW[name] for name in sorted(FILE_HEADERS))
_NO_DOCUMENTS = (b"text/css", b"text/javascript", b"font/woff2", b"image/png")
_STARTS = frozenset({"http.response.start", "websocket.http.response.start"})
"""The second type is for a response that refuses a WebSocket handshake."""
MEDIA_TYPE = "application/problem+json"


class SecurityHeaders:
    """The ASGI middleware that adds `HEADERS`, to a static file `FILE_HEADERS`; a response whose route sets
    no Cache-Control is not cached."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] in _STARTS:
                given = dict(message["headers"])
                is_file = scope["path"].startswith("/static/") and _is_no_document(given)
                usual = _RAW_OF_FILE if is_file else _RAW_OF_ALL
                added = (header for header in usual if header[0] not in given)
                message = {**message, "headers": [*message["headers"], *added]}
            await send(message)

        await self._app(scope, receive, with_headers)


def _is_no_document(headers: Mapping[bytes, bytes]) -> bool:
    return headers.get(b"content-type", b"").startswith(_NO_DOCUMENTS)


@dataclass(frozen=True, slots=True)
class Refusal:
    """A problem (RFC 9457) as the response to a request that does not get as far as the app."""

    status: int
    code: str
    detail: str
    wait_s: int = 0
    """The seconds after which the request may be repeated; 0 if that is not stated."""

    def response(self) -> bytes:
        """Return the refusal as a complete HTTP response with which its connection ends."""
        body = self._body()
        own = {"Content-Type": MEDIA_TYPE, "Content-Length": len(body), "Connection": "close"}
        headers = {**HEADERS, **own, **self._wait()}
        lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
        return f"HTTP/1.1 {self.status} {self._phrase}\r\n{lines}\r\n".encode() + body

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Respond with the refusal, as an ASGI app."""
        headers = {**HEADERS, **self._wait()}
        await Response(self._body(), self.status, headers, MEDIA_TYPE)(scope, receive, send)

    @property
    def _phrase(self) -> str:
        return HTTPStatus(self.status).phrase

    def _wait(self) -> dict[str, str]:
        return {"Retry-After": str(self.wait_s)} if self.wait_s else {}

    def _body(self) -> bytes:
        problem = {"type": "about:blank", "title": self._phrase, "status": self.status}
        return json.dumps({**problem, "code": self.code, "detail": self.detail}).encode()


MALFORMED = Refusal(400, "malformed", "this is no HTTP request; nothing was done")
TOO_SLOW = Refusal(408, "too_slow", "the request did not arrive in time; nothing was done")
TLS_REQUIRED = Refusal(
    400,
    "tls_required",
    "this port speaks https only: begin the address with https://; nothing was done",
)
NO_SUCH_EXPECTATION = Refusal(
    417, "no_such_expectation", "no expectation but 100-continue can be met; nothing was done"
)
TOO_LONG = Refusal(431, "too_long", "the headers are too long or too many; nothing was done")
TOO_MANY_REQUESTS = Refusal(429, "too_many", "too many requests of this address are under way; try again", 1)
NO_SUCH_VERSION = Refusal(505, "no_such_version", "only HTTP/1.0 and HTTP/1.1 are served; nothing was done")
TOO_MANY = Refusal(503, "too_many", "too many connections are open; nothing was done, try again")

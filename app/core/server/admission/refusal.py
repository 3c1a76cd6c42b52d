"""Responses that the server writes itself, where a request does not get as far as the app."""

from __future__ import annotations

import json
from dataclasses import dataclass
from http import HTTPStatus

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from app.core.server.security_headers import HEADERS

MEDIA_TYPE = "application/problem+json"


def last_response(status: int, media_type: str, body: bytes, **more: str) -> bytes:
    """Return a complete HTTP response with which its connection ends. ``more``: further headers by their
    names."""
    own = {"Content-Type": media_type, "Content-Length": len(body), "Connection": "close"}
    headers = {**HEADERS, **own, **more}
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    return f"HTTP/1.1 {status} {HTTPStatus(status).phrase}\r\n{lines}\r\n".encode() + body


@dataclass(frozen=True, slots=True)
class Refusal:
    """A problem (RFC 9457) for a request that could not be read; the connection ends with it."""

    status: int
    code: str
    detail: str
    wait_s: int = 0
    """After which it may be tried again; 0: it is not stated."""

    def response(self) -> bytes:
        """Return the refusal as a complete HTTP response."""
        return last_response(self.status, MEDIA_TYPE, self._body(), **self._wait())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Respond with the refusal, as an ASGI app."""
        headers = {**HEADERS, **self._wait()}
        await Response(self._body(), self.status, headers, MEDIA_TYPE)(scope, receive, send)

    def _wait(self) -> dict[str, str]:
        return {"Retry-After": str(self.wait_s)} if self.wait_s else {}

    def _body(self) -> bytes:
        phrase = HTTPStatus(self.status).phrase
        problem = {"type": "about:blank", "title": phrase, "status": self.status}
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

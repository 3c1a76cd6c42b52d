"""Responses that the server writes itself, where a request does not get as far as the app."""

from __future__ import annotations

import json
from dataclasses import dataclass
from http import HTTPStatus

from app.server.security_headers import HEADERS


@dataclass(frozen=True, slots=True)
class Refusal:
    """A problem (RFC 9457) for a request that could not be read; the connection ends with it."""

    status: int
    code: str
    detail: str

    def response(self) -> bytes:
        """The whole HTTP response."""
        phrase = HTTPStatus(self.status).phrase
        problem = {"type": "about:blank", "title": phrase, "status": self.status}
        body = json.dumps({**problem, "code": self.code, "detail": self.detail}).encode()
        headers = {
            **HEADERS,
            "Content-Type": "application/problem+json",
            "Content-Length": str(len(body)),
            "Connection": "close",
        }
        lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
        return f"HTTP/1.1 {self.status} {phrase}\r\n{lines}\r\n".encode() + body


MALFORMED = Refusal(400, "malformed", "this is no HTTP request; nothing was done")
TOO_SLOW = Refusal(408, "too_slow", "the request did not arrive in time; nothing was done")
TOO_LONG = Refusal(431, "too_long", "the headers are too long or too many; nothing was done")
TOO_MANY = Refusal(503, "too_many", "too many connections are open; nothing was done, try again")

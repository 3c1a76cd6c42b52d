"""Refuses requests before the app sees them: of foreign pages, under other host names, with ambiguous
headers.

A request that changes something, and every WebSocket handshake, must come from our own pages when a browser
sends it: browsers name the page's origin in ``Origin``. One without ``Origin`` is not from a browser's
foreign page (all of them send it with such requests), so scripts need not invent one.

``Origin`` alone does not protect a server that responds under every name: a page whose name is given our
address afterwards (DNS rebinding) is of one origin with us for the browser.
"""

from __future__ import annotations

from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket

from app.core.server.addresses import canonical
from app.core.web.admission.arrival import SAFE_METHODS
from app.core.web.problems import problem_json, refuse_socket, respond
from app.errors import Problem
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


def foreign_problem(scope: Scope) -> Problem | None:
    """The refusal of what a foreign page makes a browser send."""
    if not _is_foreign(scope):
        return None
    return Problem(403, "foreign_origin", _foreign_message(Headers(scope=scope)))


def _foreign_message(headers: Headers) -> Message:
    """Names the header that a proxy has to pass for its page to be ours."""
    origin, host = headers.get("origin", "another site"), headers.get("host", "")
    forwarded = headers.get("x-forwarded-host", "")
    if "://" not in origin:
        return Message.of("foreign_origin", origin=origin)
    if forwarded != host and same_origin(origin, forwarded):
        return Message.of("foreign_origin_untrusted", origin=origin, host=host)
    header = "X-Forwarded-Host" if forwarded == host else "Host"
    return Message.of("foreign_origin_header", origin=origin, header=header, host=host)


def _is_foreign(scope: Scope) -> bool:
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
    elif problem.code in FOR_PEOPLE and "text/html" in Headers(scope=scope).get("accept", ""):
        await respond(Request(scope), problem)(scope, receive, send)
    else:
        await problem_json(problem)(scope, receive, send)


FOR_PEOPLE = ("below_a_path", "foreign_origin", "too_large")
"""Codes of what a person meets behind a proxy; other refusals show nothing of the site."""
ONCE = ("host", "authorization", "content-type", "content-encoding", "transfer-encoding", "idempotency-key")
"""Headers that may be there once: of two, a proxy may have believed one and we the other (RFC 9110, 5.3)."""


def header_problem(scope: Scope) -> Problem | None:
    """The refusal of a header given twice, a missing Host, a path below which a proxy serves us, or a coding
    of the body that is not decoded."""
    headers = Headers(scope=scope)
    for name in ONCE:
        if len(headers.getlist(name)) > 1:
            return Problem(400, "malformed", Message.of("header_twice", name=name.title()))
    if "host" not in headers and scope.get("http_version") == "1.1":
        return Problem(400, "malformed", Message("host_missing"))
    if (prefix := headers.get("x-forwarded-prefix", "").strip("/ ")) != "":
        return Problem(421, "below_a_path", Message.of("served_below_a_path", path=f"/{prefix}"))
    if headers.get("transfer-encoding", "chunked").strip().lower() != "chunked":
        return _unknown_coding("Transfer-Encoding", 501)
    if headers.get("content-encoding", "identity").strip().lower() != "identity":
        return _unknown_coding("Content-Encoding", 415)
    return None


def _unknown_coding(name: str, status: int) -> Problem:
    """RFC 9112, 6.1 and RFC 9110, 15.5.16."""
    return Problem(status, "unsupported_type", Message.of("coding_unknown", name=name))


LOOPBACK = frozenset({"127.0.0.1", "::1", "localhost"})
OPEN_PATH = "/healthz"
"""Probes request by address, and learn only that the server is up."""


def host_problem(scope: Scope, allowed: Collection[str]) -> Problem | None:
    """The refusal, 421, under any name but these; an empty list allows all."""
    if not allowed or scope["path"] == OPEN_PATH:
        return None
    host = host_name(Headers(scope=scope).get("host", ""))
    if host in allowed or _is_local(scope, host):
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

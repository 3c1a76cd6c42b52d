"""The rules that every request must meet before the app reads it: headers, host, origin and length.

A request that changes something, and every WebSocket handshake, must come from our own pages if a browser
sends it: browsers name the page's origin in ``Origin``. A request without ``Origin`` is not from a browser's
foreign page, because all browsers send it with such requests, so scripts need not invent one. ``Origin``
alone does not protect a server that responds under every name: a page whose name is given our address
afterwards (DNS rebinding) is of one origin with us for the browser.

The bounds also keep out input that the libraries below handle in more than linear time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from typing import TypeVar
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import Message as AsgiMessage
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket

from app.core.server.addresses import canonical
from app.core.web.arrival import SAFE_METHODS
from app.core.web.problems import problem_json, refuse_socket, respond
from app.core.web.shape import parse_integer
from app.errors import Problem
from bus.messages import Message

_DEFAULT_PORTS = {"http": 80, "https": 443, "ws": 80, "wss": 443}


def _authority(scheme: str, netloc: str) -> tuple[str | None, int | None]:
    parts = urlsplit(f"//{netloc}")
    return parts.hostname, parts.port or _DEFAULT_PORTS.get(scheme)


def same_origin(origin: str, host: str) -> bool:
    """Return whether an ``Origin`` header names the requested host; ``null`` never does."""
    try:
        parts = urlsplit(origin)
        host_authority = _authority(parts.scheme, host)
        return bool(parts.netloc) and _authority(parts.scheme, parts.netloc) == host_authority
    except ValueError:
        return False


def _foreign_problem(scope: Scope) -> Problem | None:
    """Return the refusal of a request that a foreign page makes a browser send; None for any other."""
    if not _is_foreign(scope):
        return None
    return Problem(403, "foreign_origin", _foreign_message(Headers(scope=scope)))


def _foreign_message(headers: Headers) -> Message:
    """Return the reason, which names the header that a proxy has to pass so that its page counts as ours."""
    origin, host = headers.get("origin", "another site"), headers.get("host", "")
    forwarded = headers.get("x-forwarded-host", "")
    if "://" not in origin:
        return Message.of("foreign_origin", origin=origin)
    if forwarded != host and same_origin(origin, forwarded):
        return Message.of("foreign_origin_untrusted", origin=origin, host=host)
    header = "X-Forwarded-Host" if forwarded == host else "Host"
    return Message.of("foreign_origin_header", origin=origin, header=header, host=host)


def _is_foreign(scope: Scope) -> bool:
    """Return whether a foreign page makes a browser send this to change something or to listen."""
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
"""Codes of refusals that a person meets behind a proxy; others show nothing of the site."""
ONCE = (
    *("host", "origin", "authorization", "idempotency-key"),
    *("content-type", "content-encoding", "transfer-encoding"),
)
"""Headers that may occur only once: of two, a proxy may have believed one and we the other (RFC 9110,
5.3)."""


def _header_problem(scope: Scope) -> Problem | None:
    """Return the refusal of a repeated header, a missing Host, a path below which a proxy serves us, or a
    coding of the body that is not decoded."""
    headers = Headers(scope=scope)
    names = headers.keys()
    for name in ONCE:
        if names.count(name) > 1:
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
    """Return the refusal of a coding (RFC 9112, 6.1 and RFC 9110, 15.5.16)."""
    return Problem(status, "unsupported_type", Message.of("coding_unknown", name=name))


LOOPBACK = frozenset({"127.0.0.1", "::1", "localhost"})
HEALTH = "/healthz"
"""The path of probes, which request it by address and learn only that the server is up."""


def _host_problem(scope: Scope, allowed: Collection[str]) -> Problem | None:
    """Return the refusal (421) of a request under any but the allowed names; an empty list allows all."""
    if not allowed or scope["path"] == HEALTH:
        return None
    host = host_name(Headers(scope=scope).get("host", ""))
    if host in allowed or _is_local(scope, host):
        return None
    return Problem(421, "wrong_host", Message.of("host_not_served", host=host))


def host_name(text: str) -> str:
    """Return the name in a Host header, without port, in lower case; empty for an invalid one."""
    try:
        return canonical((urlsplit(f"//{text}").hostname or "").rstrip("."))
    except ValueError:
        return ""


def _is_local(scope: Scope, host: str) -> bool:
    """Return whether a request comes from this machine, under its address, as those of the bus workers of
    ``serve`` do."""
    client = (scope.get("client") or ("", 0))[0]
    server = canonical((scope.get("server") or ("", 0))[0])
    return client in (*LOOPBACK, server) and host in (*LOOPBACK, server)


MAX_BODY_BYTES = 2 * 1024 * 1024
"""The most bytes of a body with a file of parameter sets: 255 units take 0.7 MB."""
MAX_PLAIN_BODY_BYTES = 64 * 1024
"""The most bytes of any other body: the largest are the setpoints of 255 units."""
MAX_PATH = 1000
MAX_QUERY = 20_000
"""The most bytes of a query; the longest of a page names a value of each of 255 units."""
FIRST_YEAR, LAST_YEAR = 1970, 9998
"""The years in which every instant has a date in every time zone."""
MAX_PARAMETERS = 600
MAX_CONTENT_TYPE = 200
"""The most characters; a boundary of a multipart body has at most 70 (RFC 2046, 5.1.1)."""


def request_problem(scope: Scope, allowed_hosts: Collection[str]) -> Problem | None:
    """Return the refusal of a request with ambiguous headers, under another host name, of a foreign page, or
    with an address or a header longer than anything that the app needs."""
    return (
        _header_problem(scope)
        or _host_problem(scope, allowed_hosts)
        or _foreign_problem(scope)
        or _out_of_bounds(scope)
    )


def bounded(scope: Scope, receive: Receive, most_bytes: int) -> Receive:
    """Return ``receive`` for a body of at most ``most_bytes``. Raise Problem 413 if a larger length is
    announced, and in ``receive`` if the body turns out to be larger."""
    announced = parse_integer(Headers(scope=scope).get("content-length", ""))
    if announced is not None and announced > most_bytes:
        raise _too_large(most_bytes)
    seen = 0

    async def counting() -> AsgiMessage:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > most_bytes:
            raise _too_large(most_bytes)
        return message

    return counting


def _out_of_bounds(scope: Scope) -> Problem | None:
    query = scope["query_string"]
    long = len(scope["path"]) > MAX_PATH or len(query) > MAX_QUERY
    if long or query.count(b"&") > MAX_PARAMETERS:
        return Problem(414, "too_long", Message("address_too_long"))
    content_type = Headers(scope=scope).get("content-type", "")
    if len(content_type) > MAX_CONTENT_TYPE:
        return Problem(415, "unsupported_type", Message("content_type_too_long"))
    if content_type.lower().startswith("multipart/") and "charset" in content_type.lower():
        # The parts would be decoded by any codec of Python: punycode takes n² steps.
        return Problem(415, "unsupported_type", Message("form_charset"))
    return None


def readable(headers: list[tuple[bytes, bytes]]) -> Iterator[tuple[bytes, bytes]]:
    """Yield the headers without the cookies that have a quotation mark. None of ours has one, and to unquote
    it takes n² steps (CVE-2024-7592, Python before 3.11.10)."""
    for name, value in headers:
        if name == b"cookie" and b'"' in value:
            value = b";".join(pair for pair in value.split(b";") if b'"' not in pair)
        yield name, value


def _too_large(most_bytes: int) -> Problem:
    if most_bytes >= 1024**2:
        return Problem(413, "too_large", Message.of("body_over_megabytes", n=most_bytes // 1024**2))
    return Problem(413, "too_large", Message.of("body_over_kilobytes", n=most_bytes // 1024))


T = TypeVar("T")

_THREAD = ThreadPoolExecutor(1, thread_name_prefix="parsing")


async def parse_apart(parse: Callable[[], T]) -> T:
    """Run ``parse`` in the thread for large input, one call at a time, and return its result."""
    return await asyncio.get_running_loop().run_in_executor(_THREAD, parse)


def refuse_year(at: datetime, name: str) -> None:
    """Raise Problem 422 for the time that ``name`` gives if it has no date in some time zone, or is before
    any record."""
    if not FIRST_YEAR <= at.year <= LAST_YEAR:
        years = {"lowest": FIRST_YEAR, "highest": LAST_YEAR, "year": at.year}
        raise Problem(422, "invalid", Message.of("year_out_of_range", name=name, **years))

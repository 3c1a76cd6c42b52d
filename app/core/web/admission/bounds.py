"""Rules of a request, checked before anything reads it; large input is parsed beside the event loop.

The bounds also keep out what the libraries below handle in more than linear time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from typing import TypeVar

from starlette.datastructures import Headers
from starlette.types import Message as AsgiMessage
from starlette.types import Receive, Scope

from app.core.web.admission.security import foreign_problem, header_problem, host_problem
from app.core.web.api.shape import parse_integer
from app.errors import Problem
from bus.messages import Message

MAX_BODY_BYTES = 2 * 1024 * 1024
"""Bound of a body that carries a file of parameter sets: 255 units take 0.7 MB."""
MAX_PLAIN_BODY_BYTES = 64 * 1024
"""Bound of any other body: the largest are the setpoints of 255 units."""
MAX_PATH = 1000
MAX_QUERY = 20_000
"""Bytes; the longest that a page makes names a value of each of 255 units."""
FIRST_YEAR, LAST_YEAR = 1970, 9998
"""Years in which every instant has a date in every time zone."""
MAX_PARAMETERS = 600
MAX_CONTENT_TYPE = 200
"""A boundary of a multipart body has at most 70 characters (RFC 2046, 5.1.1)."""


def request_problem(scope: Scope, allowed_hosts: Collection[str]) -> Problem | None:
    """Return the refusal of a request with ambiguous headers, under another host name, of a foreign page, or
    with an address or a header longer than anything that the app needs."""
    return (
        header_problem(scope)
        or host_problem(scope, allowed_hosts)
        or foreign_problem(scope)
        or _out_of_bounds(scope)
    )


def bounded(scope: Scope, receive: Receive, most_bytes: int) -> Receive:
    """Return ``receive`` for a body of at most ``most_bytes``. Raises Problem 413 for one whose length is
    announced to be more, and in ``receive`` where it turns out to be."""
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
        # The parts would be decoded by any codec that Python has: punycode takes n² steps.
        return Problem(415, "unsupported_type", Message("form_charset"))
    return None


def readable(headers: list[tuple[bytes, bytes]]) -> Iterator[tuple[bytes, bytes]]:
    """Yield the headers without the cookies that have a quotation mark. None of ours has, and to unquote one
    takes n² steps (CVE-2024-7592, Python before 3.11.10)."""
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
    """What ``parse`` returns or raises; it runs after all that was given before."""
    return await asyncio.get_running_loop().run_in_executor(_THREAD, parse)


def refuse_year(at: datetime, name: str) -> None:
    """Raise Problem 422 for the time that ``name`` gives where it has no date in some time zone, or is before
    any record."""
    if not FIRST_YEAR <= at.year <= LAST_YEAR:
        years = {"lowest": FIRST_YEAR, "highest": LAST_YEAR, "year": at.year}
        raise Problem(422, "invalid", Message.of("year_out_of_range", name=name, **years))

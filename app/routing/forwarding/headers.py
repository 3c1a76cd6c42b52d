"""Which headers pass between a client and the home of a bus. Pure.

Both lists name what passes. What concerns one connection alone, what a client states of proxies, and what a
server may make a browser do for this server (cookies that sign in, policies) does not.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

Pairs = list[tuple[bytes, bytes]]

REQUEST = frozenset(
    {
        *(b"accept", b"accept-language", b"authorization", b"content-type", b"cookie", b"if-modified-since"),
        *(
            b"if-none-match",
            b"idempotency-key",
            b"last-event-id",
            b"lineside-clicked-at",
            b"lineside-sent-at",
        ),
        *(b"lineside-asked-at", b"origin", b"referer", b"sec-fetch-site", b"user-agent", b"range"),
    }
)
REQUEST_PREFIX = b"hx-"
RESPONSE = frozenset(
    {
        *(b"allow", b"cache-control", b"content-disposition", b"content-language", b"content-length"),
        *(b"content-type", b"etag", b"expires", b"last-modified", b"retry-after", b"www-authenticate"),
        *(b"x-accel-buffering", b"hx-retarget", b"hx-reswap", b"hx-reselect", b"hx-trigger", b"hx-refresh"),
        *(b"ratelimit-limit", b"ratelimit-remaining", b"ratelimit-reset"),
        *(b"hx-push-url", b"hx-replace-url", b"content-range", b"accept-ranges"),
    }
)
ADDRESSES = frozenset({b"location", b"hx-redirect", b"hx-location"})
"""Of a response: pass where they lead to a path of this site."""
COOKIES = (b"lineside_view",)
"""What the home of a bus may set: how a page is shown, never who is signed in."""
_NEXT_PAGE = re.compile(rb'<(/[!-=?-~]*)>; rel="next"')
_OWN_PATH = re.compile(rb"/(?![/\\])[\x21-\x7e]*")
_VALUE = re.compile(rb"[\t\x20-\x7e\x80-\xff]*")
MAX_VALUE_BYTES = 16 * 1024


def to_home(headers: Iterable[tuple[bytes, bytes]]) -> Pairs:
    """The headers of a request that its home gets, in lower case."""
    return [
        (name, value)
        for name, value in headers
        if (name in REQUEST or name.startswith(REQUEST_PREFIX)) and _is_value(value)
    ]


def to_client(headers: Iterable[tuple[bytes, bytes]]) -> Pairs:
    """The headers of a response that its client gets."""
    return list(_passed(headers))


def _passed(headers: Iterable[tuple[bytes, bytes]]) -> Iterator[tuple[bytes, bytes]]:
    for given, value in headers:
        name = given.lower()
        if not _is_value(value):
            continue
        is_cookie = name == b"set-cookie" and value.partition(b"=")[0].strip() in COOKIES
        is_address = name in ADDRESSES and _OWN_PATH.fullmatch(value)
        is_next = name == b"link" and _NEXT_PAGE.fullmatch(value)
        if name in RESPONSE or is_cookie or is_address or is_next:
            yield name, value


def _is_value(value: bytes) -> bool:
    """Whether it cannot end its line, which would begin another header."""
    return len(value) <= MAX_VALUE_BYTES and _VALUE.fullmatch(value) is not None

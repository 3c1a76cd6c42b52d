"""A request ready to send: its bytes, and how long its response may be. Reads are prepared once."""

from __future__ import annotations

from functools import lru_cache

import msgspec

from bus.settings import Dialect
from bus.wire.bodies import request_body
from bus.wire.commands import Request, is_write
from bus.wire.describe import is_secret
from bus.wire.framing import encode_frame
from bus.wire.lengths import least_reply_bytes, longest_reply_bytes

MAX_KEPT = 4096
"""More than 40 parameters and the status of all the units that one bus commonly has."""


class Prepared(msgspec.Struct, frozen=True):
    """``wire`` is the frame, ``body`` what it carries; ``secret``: neither may be kept or shown (#21)."""

    request: Request
    body: bytes
    wire: bytes
    least_reply_bytes: int
    longest_reply_bytes: int
    secret: bool


def prepare(request: Request, dialect: Dialect) -> Prepared:
    """Raises CallerError for an address, number or value outside the manual's ranges."""
    if is_write(request):
        return _prepare(request, dialect)
    return _prepare_read(
        request, dialect.checksum_10h, dialect.parameter_reply_bytes, dialect.parameter_numbers
    )


def _prepare(request: Request, dialect: Dialect) -> Prepared:
    body = request_body(request, dialect)
    return Prepared(
        request,
        body,
        encode_frame(body, dialect),
        least_reply_bytes(request, dialect),
        longest_reply_bytes(request, dialect),
        is_secret(request),
    )


@lru_cache(MAX_KEPT)
def _prepare_read(request: Request, checksum_10h: str, reply_bytes: int, numbers: str) -> Prepared:
    """Prepare a read; what the dialect decides of its bytes is plain values, which compare quickly."""
    how = {"checksum_10h": checksum_10h, "parameter_reply_bytes": reply_bytes, "parameter_numbers": numbers}
    return _prepare(request, Dialect.model_validate(how))

"""How many bytes a response has, and how long bytes take on the wire."""

from __future__ import annotations

from bus.settings import Dialect
from bus.wire.commands import TRAITS, ReadParameterRequest, Request

_FRAME_OVERHEAD = 5
"""10 02 before the body; 10 03 and the checksum after it."""


def acknowledged_lengths(request: Request, dialect: Dialect) -> frozenset[int]:
    """How many data bytes an ACK to ``request`` may carry."""
    width = dialect.parameter_reply_bytes
    if width and request.COMMAND == ReadParameterRequest.COMMAND:
        return frozenset((width,))
    return TRAITS[request.COMMAND].acknowledged


def usual_reply_bytes(request: Request, dialect: Dialect) -> int:
    """Return the bytes on the wire of an ordinary response without a 10h; 0 for a broadcast."""
    return _reply_bytes(request, dialect, bytes_per_byte=1)


def least_reply_bytes(request: Request, dialect: Dialect) -> int:
    """Return the bytes on the wire of the shortest acknowledgement; 0 for a broadcast."""
    if request.unit == 0:
        return 0
    return _FRAME_OVERHEAD + 2 + min(acknowledged_lengths(request, dialect))


def longest_reply_bytes(request: Request, dialect: Dialect) -> int:
    """Return the bytes on the wire of the longest response, every byte of it 10h; 0 for a broadcast."""
    doubled_checksum = 1 if request.unit and dialect.checksum_10h == "twice" else 0
    return _reply_bytes(request, dialect, bytes_per_byte=2) + doubled_checksum


def _reply_bytes(request: Request, dialect: Dialect, bytes_per_byte: int) -> int:
    if request.unit == 0:
        return 0
    nak_data = 1
    data = max(nak_data, *acknowledged_lengths(request, dialect))
    return _FRAME_OVERHEAD + bytes_per_byte * (2 + data)

"""Frames from bytes, after the manual: ``10 02 body 10 03 checksum``, each 10h of the body sent twice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

DLE, STX, ETX, ACK = 0x10, 0x02, 0x03, 0x06
SET_AND_EXECUTE, READ_PARAMETER = 0x84, 0x85
STATUS_BYTES = 13
"""UID, ACK and the eleven bytes of the response to 81h."""


@dataclass(frozen=True)
class Piece:
    """``data`` came at ``at`` (Unix time)."""

    at: float
    data: bytes


@dataclass(frozen=True)
class WireFrame:
    """A complete frame with a right checksum: ``body`` unstuffed, ``began`` and ``ended`` in Unix time."""

    began: float
    ended: float
    body: bytes

    @property
    def unit(self) -> int:
        return self.body[0]

    @property
    def command(self) -> int:
        return self.body[1]

    @property
    def value(self) -> int:
        """The four bytes of an 82h or 84h."""
        return int.from_bytes(self.body[2:6], "big")

    @property
    def shown(self) -> int | None:
        """The commanded speed of a response to 81h, or the value of one to 85h; None: it has neither."""
        if self.command != ACK or len(self.body) == 2:
            return None
        return int.from_bytes(self.body[2 : 6 if self.status else None], "big")

    @property
    def status(self) -> tuple[int, int, int] | None:
        """Commanded and actual speed and the analog input, where this is a response to 81h."""
        if self.command != ACK or len(self.body) != STATUS_BYTES:
            return None
        return int.from_bytes(self.body[2:6], "big"), int.from_bytes(self.body[6:10], "big"), self.body[10]


@dataclass(frozen=True)
class Stray:
    """Bytes that belong to no frame."""

    at: float
    data: bytes


def decode(pieces: Iterable[Piece]) -> Iterator[WireFrame | Stray]:
    """Every byte in order, as part of a frame or as a stray; a frame that fails gives up one byte only."""
    data = bytearray()
    times: list[float] = []
    for piece in pieces:
        data += piece.data
        times += [piece.at] * len(piece.data)
    place = stray_from = 0
    while place < len(data):
        found = _frame_at(data, place)
        if found is None:
            place += 1
            continue
        body, end = found
        if stray_from < place:
            yield Stray(times[stray_from], bytes(data[stray_from:place]))
        yield WireFrame(times[place], times[end - 1], body)
        place = stray_from = end
    if stray_from < len(data):
        yield Stray(times[stray_from], bytes(data[stray_from:]))


def _frame_at(data: bytearray, start: int) -> tuple[bytes, int] | None:
    """The body of the frame that begins here, and one past its end."""
    if data[start : start + 2] != bytes((DLE, STX)):
        return None
    body, place = bytearray(), start + 2
    while place < len(data) and len(body) <= STATUS_BYTES:
        byte = data[place]
        if byte != DLE:
            body.append(byte)
            place += 1
            continue
        after = data[place + 1 : place + 2]
        if after == bytes((DLE,)):
            body.append(DLE)
            place += 2
            continue
        checksum = data[place + 2 : place + 3]
        complete = after == bytes((ETX,)) and checksum == bytes((-sum(body) & 0xFF,)) and len(body) >= 2
        return (bytes(body), place + 3) if complete else None
    return None

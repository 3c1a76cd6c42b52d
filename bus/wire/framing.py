"""Frames on the wire: ``10 02 body 10 03 checksum``, with every 10h of the body sent twice (manual, 2.0).

The rules of receiving, in the order in which they are applied:

1. Outside a frame everything up to the next ``10 02`` is noise.
2. Inside a frame ``10 10`` is the byte 10h, ``10 03`` ends the body, and exactly one byte after it is
   the checksum. ``10 02`` restarts the frame; 10h before anything else, a body longer than the longest legal
   one, one too short for an address and a command, and a wrong checksum each end the candidate.
3. After a candidate has failed only its first byte is given up: the search goes on one byte after its
   start, so a good frame that begins inside a bad one is not lost.
4. A single 10h right after a frame whose checksum is 10h is that checksum sent twice, not noise.

A candidate is never longer than ``_LONGEST_CANDIDATE`` bytes, so each byte is examined a bounded number of
times whatever arrives. The events depend on the bytes alone, not on how they were cut, and their bytes,
joined, are the bytes that came in.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from typing import NamedTuple

import msgspec

from bus.errors import CallerError
from bus.messages import Message
from bus.settings import Dialect

DLE, STX, ETX, ACK, NAK = 0x10, 0x02, 0x03, 0x06, 0x15
MIN_BODY = 2
"""The least bytes of a body: UID and a command or ACK."""
MAX_BODY = 13
"""The most bytes of a body: UID, ACK and the eleven bytes of the response to 81h."""
MAX_NOISE = 64
"""Noise is reported in pieces of at most this many bytes."""

_START = bytes((DLE, STX))
_END = bytes((DLE, ETX))


class Fault(StrEnum):
    """The reason why bytes are not a frame."""

    OUTSIDE = "outside"
    RESTART = "restart"
    ESCAPE = "escape"
    TOO_LONG = "too_long"
    TOO_SHORT = "too_short"
    CHECKSUM = "checksum"
    CUT = "cut"


class ReceivedFrame(msgspec.Struct, frozen=True):
    """A complete frame with the right checksum. ``body`` is unstuffed, ``wire`` is as received."""

    body: bytes
    wire: bytes


class Noise(msgspec.Struct, frozen=True):
    """Bytes that belong to no good frame.

    ``body`` is the unstuffed content of a frame that is complete except for its checksum, otherwise empty.
    """

    data: bytes
    reason: Fault
    body: bytes = b""


class DoubledChecksum(msgspec.Struct, frozen=True):
    """The second 10h of a checksum that was sent twice; it belongs to the frame before it."""

    data: bytes = bytes((DLE,))


Received = ReceivedFrame | Noise | DoubledChecksum


class _CandidateEnd(NamedTuple):
    """The judgment of a candidate; ``end`` is one past the byte that decided."""

    end: int
    fault: Fault | None
    body: bytes = b""


def checksum(body: bytes) -> int:
    """Return the two's complement of the sum of the unstuffed bytes (manual, 2.0: by its example frame, which
    its prose contradicts)."""
    return -sum(body) & 0xFF


def encode_frame(body: bytes, dialect: Dialect) -> bytes:
    """Return the frame of ``body`` ([UID][CMD or ACK/NAK][data]). Raise CallerError if none can carry it."""
    if not MIN_BODY <= len(body) <= MAX_BODY:
        raise CallerError(
            Message.of("frame_length_illegal", lowest=MIN_BODY, highest=MAX_BODY, count=len(body))
        )
    check = bytes((checksum(body),))
    if check[0] == DLE and dialect.checksum_10h == "twice":
        check += check
    return _START + body.replace(b"\x10", b"\x10\x10") + _END + check


class FrameDecoder:
    """The decoder of received bytes into frames and noise, the same in every dialect."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect
        self._buffer = bytearray()
        self._after_checksum_10h = False

    @property
    def pending(self) -> int:
        """Bytes received that are not yet part of an event."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Received]:
        """Decode ``data``, cut anywhere; return the events that are now certain."""
        self._buffer += data
        return list(self._events())

    def flush(self) -> list[Received]:
        """End the reception: return unfinished bytes as noise or as frames."""
        events = list(self._events())
        while self._buffer:
            events.append(self._abandon())
            events += self._events()
        return events

    def _events(self) -> Iterator[Received]:
        while self._buffer:
            if self._after_checksum_10h:
                if len(self._buffer) == 1 and self._buffer[0] == DLE:
                    return
                self._after_checksum_10h = False
                if self._buffer[0] == DLE and self._buffer[1] != STX:
                    yield DoubledChecksum(self._take(1))
                    continue
            start = self._buffer.find(_START)
            yield from self._noise_before(start)
            if start < 0:
                return
            ended = _judge(self._buffer)
            if ended is None:
                return
            if ended.fault is None:
                yield self._accept(ended)
            else:
                yield self._give_up(ended.end, ended.fault, ended.body)

    def _noise_before(self, start: int) -> Iterator[Noise]:
        """Yield the noise before ``start``; without a start (-1) only what exceeds one piece."""
        known = start if start >= 0 else len(self._buffer)
        while known > MAX_NOISE or (start >= 0 and known > 0):
            piece = min(known, MAX_NOISE)
            known -= piece
            yield Noise(self._take(piece), Fault.OUTSIDE)

    def _accept(self, ended: _CandidateEnd) -> ReceivedFrame:
        self._after_checksum_10h = self._buffer[ended.end - 1] == DLE
        return ReceivedFrame(ended.body, self._take(ended.end))

    def _give_up(self, end: int, fault: Fault, body: bytes) -> Noise:
        """Give up a candidate but keep all from the next possible start on (rule 3), which may be a lone
        10h."""
        next_start = self._buffer.find(_START, 1, end)
        if next_start < 0:
            next_start = end - 1 if self._buffer[end - 1] == DLE else end
        return Noise(self._take(next_start), fault, body)

    def _abandon(self) -> Received:
        if self._after_checksum_10h:
            self._after_checksum_10h = False
            return DoubledChecksum(self._take(1))
        if not self._buffer.startswith(_START):
            return Noise(self._take(len(self._buffer)), Fault.OUTSIDE)
        next_start = self._buffer.find(_START, 1)
        return Noise(self._take(next_start if next_start > 0 else len(self._buffer)), Fault.CUT)

    def _take(self, count: int) -> bytes:
        taken = bytes(self._buffer[:count])
        del self._buffer[:count]
        return taken


def _judge(buffer: bytearray) -> _CandidateEnd | None:
    """Return the end of the candidate at the head of ``buffer``; None while it may still become a frame."""
    body = bytearray()
    at = len(_START)
    while True:
        room = MAX_BODY + 1 - len(body)
        dle = buffer.find(DLE, at, at + room)
        plain_ends = dle if dle >= 0 else min(at + room, len(buffer))
        body += buffer[at:plain_ends]
        if len(body) > MAX_BODY:
            return _CandidateEnd(plain_ends, Fault.TOO_LONG)
        at = plain_ends + 2
        if at > len(buffer):
            return None
        follower = buffer[at - 1]
        if follower == ETX:
            return _judge_end(buffer, at, bytes(body))
        if follower != DLE:
            return _CandidateEnd(at, Fault.RESTART if follower == STX else Fault.ESCAPE)
        body.append(DLE)
        if len(body) > MAX_BODY:
            return _CandidateEnd(at, Fault.TOO_LONG)


def _judge_end(buffer: bytearray, at: int, body: bytes) -> _CandidateEnd | None:
    if len(body) < MIN_BODY:
        return _CandidateEnd(at, Fault.TOO_SHORT)
    if at == len(buffer):
        return None
    fault = None if buffer[at] == checksum(body) else Fault.CHECKSUM
    return _CandidateEnd(at + 1, fault, body)

"""Faults on demand: how a bad unit, cable or adapter changes a response; seeded, by rate.

Pure: a frame goes in, pieces with delays come out. A fault belongs to one unit (by its address) or, under
address 0, to every unit of the line.
"""

from __future__ import annotations

import random
from collections import defaultdict
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from bus.errors import UnitErrorCode
from bus.settings import Dialect
from bus.wire.commands import TRAITS
from bus.wire.framing import ACK, checksum, encode_frame

EVERY_UNIT = 0
LATE_S = 0.4
"""Beyond any timeout of a host with the default turnaround of 50 ms."""
SLOW_S = 0.03
"""Slower than usual, yet within that turnaround."""
HUGE_BYTES = 10_000


class FaultKind(StrEnum):
    """The faults. Those above the line act when a request arrives, the others on the response."""

    DEAD = "dead"
    """The request is not received: power off, or the drop cut."""
    NAK = "nak"
    """The unit refuses, truly: it does not act."""
    ALL_ADDRESSES = "all_addresses"
    """The unit takes every address for its own."""
    ECHO = "echo"
    """Line only: the adapter returns the host's bytes to it."""
    FLOOD = "flood"
    """Line only: bytes without end that never frame, as long as the rate is not 0."""

    LATE = "late"
    SLOW = "slow"
    LOST = "lost"
    DOUBLED = "doubled"
    FOREIGN = "foreign"
    """The response carries another unit's address."""
    CUT = "cut"
    CORRUPT = "corrupt"
    NOISE = "noise"
    """Noise before or after the response."""
    WRONG_LENGTH = "wrong_length"
    """A complete frame with a right checksum, and data that fits no command's response."""
    HUGE = "huge"
    """A frame of 10,000 bytes."""


class Piece(NamedTuple):
    """Bytes that a unit puts on the line ``delay`` seconds later than a good response would begin."""

    delay: float
    data: bytes


@dataclass
class Faults:
    """The present rates. One instance serves an entire line; every draw comes from its seed."""

    seed: int = 0
    late_s: float = LATE_S
    foreign_address: int = 0
    """The address that FOREIGN responses carry; 0: that of the next unit."""
    _rates: dict[int, dict[FaultKind, float]] = field(default_factory=lambda: defaultdict(dict))
    _random: random.Random = field(init=False)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def set(self, kind: FaultKind, rate: float, unit: int = EVERY_UNIT) -> None:
        """Set the ``rate`` of ``kind`` (0 never, 1 always) for ``unit`` or for every unit."""
        if rate:
            self._rates[unit][kind] = rate
        else:
            self._rates[unit].pop(kind, None)

    def clear(self) -> None:
        self._rates.clear()

    def strikes(self, kind: FaultKind, unit: int = EVERY_UNIT) -> bool:
        """Whether ``kind`` happens now; draws nothing where its rate is 0, so that it disturbs no seed."""
        rate = max(self._rates[EVERY_UNIT].get(kind, 0.0), self._rates[unit].get(kind, 0.0))
        return rate > 0 and self._random.random() < rate

    def refusal(self, command: int) -> int:
        """The code of a NAK out of nowhere: one of those that the manual lists for ``command``."""
        listed = sorted(TRAITS[command].refusals) if command in TRAITS else []
        return self._random.choice([*listed, UnitErrorCode.ILLEGAL_COMMAND])

    def noise_bytes(self, count: int) -> bytes:
        """``count`` bytes without a frame in them: no 10h, so nothing ever starts or ends."""
        return bytes(self._random.choice(_NO_DLE) for _ in range(count))

    def spoil(self, unit: int, frame: bytes, body: bytes) -> list[Piece]:
        """Apply the first of the faults that strike to a response: ``frame`` as the unit wrote it, ``body``
        its content.
        """
        kind = next((kind for kind in _ON_RESPONSES if self.strikes(kind, unit)), None)
        match kind:
            case FaultKind.LATE:
                return [Piece(self.late_s * self._random.uniform(0.5, 1.5), frame)]
            case FaultKind.SLOW:
                return [Piece(SLOW_S, frame)]
            case FaultKind.LOST:
                return []
            case FaultKind.DOUBLED:
                return [Piece(0.0, frame), Piece(0.0, frame)]
            case None:
                return [Piece(0.0, frame)]
        return [Piece(0.0, self._spoilt(kind, frame, body))]

    def _spoilt(self, kind: FaultKind, frame: bytes, body: bytes) -> bytes:
        match kind:
            case FaultKind.FOREIGN:
                other = self.foreign_address or body[0] % 255 + 1
                return encode_frame(bytes((other,)) + body[1:], _PLAIN)
            case FaultKind.CUT:
                return frame[: self._random.randrange(1, len(frame))]
            case FaultKind.CORRUPT:
                spoilt = bytearray(frame)
                spoilt[self._random.randrange(len(frame))] ^= self._random.randrange(1, 256)
                return bytes(spoilt)
            case FaultKind.NOISE:
                noise = self.noise_bytes(self._random.randrange(1, 12))
                return self._random.choice((noise + frame, frame + noise))
            case FaultKind.WRONG_LENGTH:
                length = self._random.choice((3, 5, 7, 9))
                odd = bytes(self._random.randrange(256) for _ in range(length))
                return encode_frame(bytes((body[0], ACK)) + odd, _PLAIN)
        huge = bytes((body[0], ACK)) + self.noise_bytes(HUGE_BYTES)
        return b"\x10\x02" + huge + b"\x10\x03" + bytes((checksum(huge),))


_PLAIN = Dialect()
_NO_DLE = bytes(value for value in range(256) if value != 0x10)
_ON_RESPONSES = tuple(FaultKind)[tuple(FaultKind).index(FaultKind.LATE) :]

"""What a simulated line received, did and sent: an independent record by which tests judge a host."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum

MAX_RECORD = 200_000
"""Entries kept; the oldest go first."""


class WireEventKind(StrEnum):
    """The kinds of entry."""

    CAME = "came"
    """Bytes that the host wrote, at the time it wrote them."""
    RECEIVED = "received"
    """A complete request reached a unit; ``at`` is its last byte. Unit 0: no unit has its address."""
    ACTED = "acted"
    """The unit carried out the write in ``data``."""
    RESPONDED = "responded"
    """The unit's response, before any fault."""
    SENT = "sent"
    """Bytes put on the line to the host, faults and all; ``at`` is when the last of them is out."""


@dataclass(frozen=True, slots=True)
class WireEvent:
    """``number`` counts from 1; ``at`` is on the line's clock; ``data`` is a body for RECEIVED, ACTED and
    RESPONDED (the bytes between STX and DLE ETX), else bytes as on the wire.
    """

    number: int
    at: float
    what: WireEventKind
    unit: int
    data: bytes


@dataclass
class WireRecord:
    """Bounded, in the order of happening."""

    _entries: deque[WireEvent] = field(default_factory=lambda: deque(maxlen=MAX_RECORD))
    count: int = 0

    def add(self, at: float, what: WireEventKind, unit: int, data: bytes) -> None:
        self.count += 1
        self._entries.append(WireEvent(self.count, at, what, unit, data))

    def since(self, number: int = 0, *what: WireEventKind) -> Iterator[WireEvent]:
        """The entries after ``number`` of the kinds ``what`` (default all); another thread may call it."""
        entries = tuple(self._entries)  # In one step for the interpreter.
        known = number - entries[0].number + 1 if entries else 0
        return (entry for entry in entries[max(known, 0) :] if not what or entry.what in what)

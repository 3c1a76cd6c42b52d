"""When each byte is on the wire: a UART's timetable as pure arithmetic, time passed in, seconds.

A byte takes ten bits. Every time counts from the end of the byte before, never from when a process woke up,
so lateness does not add up.
"""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

WAKE_S = 0.004
"""Bytes inside a frame may wait for each other so long, as in an adapter's buffer; its first and last not."""


@dataclass(slots=True)
class RequestLine:
    """The pair from the host to the units: bytes handed over early wait for those before them."""

    free_at: float = 0.0

    def carry(self, now: float, count: int, byte_s: float) -> list[float]:
        """The times at which ``count`` bytes, written at ``now``, have completely arrived."""
        start = max(now, self.free_at)
        self.free_at = start + count * byte_s
        return [start + place * byte_s for place in range(1, count + 1)]


class Slot(NamedTuple):
    """One byte on the reply pair, complete at ``due``; its position in what a talker sends."""

    due: float
    value: int
    first: bool
    last: bool


class Wake(NamedTuple):
    """When something is due. ``sharp``: the host waits for just that."""

    at: float
    sharp: bool


@dataclass(slots=True)
class ReplyLine:
    """The pair from the units to the host. Each talker speaks in order; two at once garble each other."""

    _slots: deque[Slot] = field(default_factory=deque)
    _free_at: dict[int, float] = field(default_factory=dict)
    _random: random.Random = field(default_factory=lambda: random.Random(0))

    def transmit(self, talker: int, at: float, data: bytes, byte_s: float) -> float:
        """Put ``data`` on the line from ``at`` on, or once ``talker`` is done; when its last byte is out."""
        if not data:
            return at
        start = max(at, self._free_at.get(talker, 0.0))
        last = len(data) - 1
        slots = [
            Slot(start + (place + 1) * byte_s, value, place == 0, place == last)
            for place, value in enumerate(data)
        ]
        self._free_at[talker] = slots[-1].due
        if not self._slots or self._slots[-1].due <= start:
            self._slots.extend(slots)
        else:
            self._slots = deque(self._collide(slots, byte_s))
        return slots[-1].due

    def due(self, now: float) -> bytes:
        """The bytes that the host has by ``now`` and had not before."""
        arrived = bytearray()
        while self._slots and self._slots[0].due <= now:
            arrived.append(self._slots.popleft().value)
        return bytes(arrived)

    def wake(self) -> Wake | None:
        """Return when to look again: at the next first or last byte, or after ``WAKE_S`` between them."""
        if not self._slots:
            return None
        latest = self._slots[0].due + WAKE_S
        for slot in self._slots:
            if slot.due > latest:
                break
            if slot.first or slot.last:
                return Wake(slot.due, sharp=slot.last)
        return Wake(latest, sharp=False)

    def clear(self) -> None:
        """The cable is gone, and what was on it."""
        self._slots.clear()

    def _collide(self, slots: list[Slot], byte_s: float) -> list[Slot]:
        """Bytes of two talkers less than a byte time apart become one that is neither's."""
        merged: list[Slot] = []
        for slot in sorted((*self._slots, *slots)):
            if merged and slot.due - merged[-1].due < byte_s * 0.999:
                before = merged.pop()
                value = before.value & slot.value & self._random.randrange(256)
                slot = Slot(before.due, value, before.first or slot.first, before.last or slot.last)
            merged.append(slot)
        return merged

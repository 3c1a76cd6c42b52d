"""How often open pages are told: of every answer, unless there is a flood of them or very many pages. Pure
but for the clock, which is passed in."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bus.instants import Monotonic, MonotonicClock, monotonic_now

FLOOD = 60
WINDOW_S = 0.25
"""More changed units than this within a window, which is more than six full wires bring, and the pages are
told once in a window until it is quieter: they could not draw them all, and have other things to do."""

FEW_PAGES = 40
MOST_TOLD_S = 2000
"""With more pages than a few, none is told again before its share of so many messages a second: the server
has other things to do. 200 pages are told ten times a second, 40 and fewer of every single answer."""


@dataclass(slots=True)
class Flow:
    """How much there was to tell lately, by a monotonic clock in seconds."""

    clock: MonotonicClock = monotonic_now
    _gap_s: float = 0.0
    _began: Monotonic = Monotonic(0.0)
    _count: int = 0
    _flooded: bool = False
    _told_at: Monotonic = Monotonic(-math.inf)

    def share(self, pages: int) -> None:
        """So many pages are open in all."""
        self._gap_s = pages / MOST_TOLD_S if pages > FEW_PAGES else 0.0

    def came(self, units: int = 1) -> None:
        """There is something new of so many units."""
        now = self.clock()
        if now - self._began >= WINDOW_S:
            self._flooded = self._count > FLOOD and now - self._began < 2 * WINDOW_S
            self._began, self._count = now, 0
        self._count += units

    def pause_s(self) -> float:
        """How long to wait before telling again: nothing unless there is a flood, or very many pages."""
        flooded = self._flooded or self._count > FLOOD
        gap_s = max(self._gap_s, WINDOW_S) if flooded else self._gap_s
        return max(0.0, self._told_at + gap_s - self.clock())

    def told(self) -> None:
        """Everything was told."""
        self._told_at = self.clock()

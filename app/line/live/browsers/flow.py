"""How often open pages are updated: on every response, except in a flood of them or with very many pages.
Pure but for the clock, which is passed in."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bus.instants import Monotonic, MonotonicClock, monotonic_now

FLOOD = 60
WINDOW_S = 0.25
"""More changed units than this within a window, which is more than six full wires bring: updates then go
out once per window until it is quieter, as pages could not draw them all."""

FEW_PAGES = 40
MAX_SENDS_S = 2000
"""With many pages each gets at most its share of so many messages a second, to bound the server's
load. 200 pages get ten updates a second, 40 and fewer one for each response."""


@dataclass(slots=True)
class Flow:
    """Counts recent changes, by a monotonic clock in seconds."""

    clock: MonotonicClock = monotonic_now
    _gap_s: float = 0.0
    _began: Monotonic = Monotonic(0.0)
    _count: int = 0
    _flooded: bool = False
    _sent_at: Monotonic = Monotonic(-math.inf)

    def share(self, pages: int) -> None:
        """Set the number of open pages."""
        self._gap_s = pages / MAX_SENDS_S if pages > FEW_PAGES else 0.0

    def came(self, units: int = 1) -> None:
        """There is something new of so many units."""
        now = self.clock()
        if now - self._began >= WINDOW_S:
            self._flooded = self._count > FLOOD and now - self._began < 2 * WINDOW_S
            self._began, self._count = now, 0
        self._count += units

    def pause_s(self) -> float:
        """Seconds to wait before the next update: 0 except in a flood, or with very many pages."""
        flooded = self._flooded or self._count > FLOOD
        gap_s = max(self._gap_s, WINDOW_S) if flooded else self._gap_s
        return max(0.0, self._sent_at + gap_s - self.clock())

    def sent(self) -> None:
        self._sent_at = self.clock()

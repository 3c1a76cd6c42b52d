"""How often something happened in the last minute, from counters that only grow. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from app.conditions.evidence import CountPredicate
from bus.instants import UnixTime

WINDOW_S = 60.0


@dataclass(slots=True)
class CountWindow:
    """``total`` and ``faults`` of the last complete window; None until one is over."""

    total: int | None = None
    faults: int | None = None
    _at: UnixTime | None = None
    _from: tuple[int, int] = (0, 0)

    def judged(self, holds: CountPredicate) -> bool | None:
        """Whether a condition holds by the last window; None until one is over."""
        return None if self.total is None or self.faults is None else holds(self.total, self.faults)

    def restart(self) -> None:
        """Count from the next counters on."""
        self._at = None

    def see(self, total: int, faults: int, at: UnixTime) -> None:
        """Take in the counters. A worker that was started again counts from zero."""
        is_restarted = total < self._from[0] or faults < self._from[1]
        if self._at is None or is_restarted or at < self._at:
            self._at, self._from = at, (total, faults)
        elif at - self._at >= WINDOW_S:
            self.total, self.faults = total - self._from[0], faults - self._from[1]
            self._at, self._from = at, (total, faults)

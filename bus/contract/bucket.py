"""How much one side of the link may send the other. Pure: ``now`` is a monotonic time in seconds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Bucket:
    """A leaky bucket: ``capacity`` at once, ``per_s`` in the long run."""

    per_s: float
    capacity: float
    _level: float = 0.0
    _at: float = 0.0

    def pour(self, amount: float, now: float) -> float:
        """Take ``amount`` in; for how many seconds nothing more should come (0.0: at once)."""
        self._level = max(0.0, self._level - (now - self._at) * self.per_s) + amount
        self._at = now
        return max(0.0, self._level - self.capacity) / self.per_s

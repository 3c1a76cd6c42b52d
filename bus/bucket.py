"""How much of something is allowed, by time. Pure: ``now`` in seconds; a step back costs nothing."""

from __future__ import annotations

from dataclasses import dataclass

from bus.instants import Monotonic


@dataclass(slots=True)
class Bucket:
    """A leaky bucket: ``capacity`` at once, ``per_s`` in the long run."""

    per_s: float
    capacity: float
    _level: float = 0.0
    _at: Monotonic = Monotonic(0.0)

    def level(self, now: Monotonic) -> float:
        self._level = max(0.0, self._level - max(0.0, now - self._at) * self.per_s)
        self._at = now
        return self._level

    def has_room(self, now: Monotonic, amount: float = 1.0) -> bool:
        """Whether so much more fits."""
        return self.level(now) + amount <= self.capacity

    def take(self, now: Monotonic, amount: float = 1.0) -> bool:
        """Add all of it, where it fits."""
        if not self.has_room(now, amount):
            return False
        self._level += amount
        return True

    def pour(self, amount: float, now: Monotonic) -> float:
        """Add ``amount`` (below 0: take out), beyond the capacity too; for how many seconds nothing more
        should come (0.0: at once)."""
        self._level = max(0.0, self.level(now) + amount)
        return max(0.0, self._level - self.capacity) / self.per_s

    def wait_s(self, now: Monotonic, amount: float = 1.0) -> float:
        """Return in how many seconds ``amount`` more fits; 0.0: now."""
        return max(0.0, self.level(now) + amount - self.capacity) / self.per_s

    def fill(self, now: Monotonic) -> None:
        self._level = max(self.level(now), self.capacity)

"""Limits of how often something may be done, and pauses before a lost link is tried again. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bus.instants import Monotonic


@dataclass(slots=True)
class Bucket:
    """A leaky bucket: ``capacity`` at once, ``per_s`` in the long run. A clock set back costs nothing."""

    per_s: float
    capacity: float
    _level: float = 0.0
    _at: Monotonic = Monotonic(0.0)

    def level(self, now: Monotonic) -> float:
        self._level = max(0.0, self._level - max(0.0, now - self._at) * self.per_s)
        self._at = now
        return self._level

    def has_room(self, now: Monotonic, amount: float = 1.0) -> bool:
        """Return whether ``amount`` more fits."""
        return self.level(now) + amount <= self.capacity

    def take(self, now: Monotonic, amount: float = 1.0) -> bool:
        """Add ``amount`` if all of it fits; return whether it did."""
        if not self.has_room(now, amount):
            return False
        self._level += amount
        return True

    def pour(self, amount: float, now: Monotonic) -> float:
        """Add ``amount`` (below 0: take out), even beyond the capacity; return the seconds in which nothing
        more should come."""
        self._level = max(0.0, self.level(now) + amount)
        return max(0.0, self._level - self.capacity) / self.per_s

    def wait_s(self, now: Monotonic, amount: float = 1.0) -> float:
        """Return the seconds until ``amount`` more fits; 0.0 if it fits now."""
        return max(0.0, self.level(now) + amount - self.capacity) / self.per_s

    def fill(self, now: Monotonic) -> None:
        self._level = max(self.level(now), self.capacity)


STABLE_S = 10.0
"""The seconds that a link must last to count as stable."""
FIRST_PAUSE_S = 0.5
MAX_PAUSE_S = 30.0
MAX_USEFUL_PAUSE_S = 0.5
"""The longest pause if the link is useful in between: a plug with a bad contact."""
JITTER = 0.25


@dataclass(slots=True)
class ReconnectDelay:
    """The pause before a lost link is tried again.

    A link that worked for a while and then breaks, by a pulled cable or a restarted app, is tried again at
    once. One that begins and ends again and again, such as a device server that accepts and closes, is tried
    less and less often, and only some of its ends are worth a line in the log. ``random`` returns numbers
    from 0 to 1, so that many clients of one lost server do not come back together.
    """

    random: Callable[[], float]
    count: int = 0
    """The number of times in a row that the link ended too soon."""

    def ended(self, lasted_s: float, *, useful: bool = False) -> float:
        """Note an end after ``lasted_s``, ``useful`` if data came; return the seconds to wait."""
        if lasted_s >= STABLE_S:
            self.count = 0
            return 0.0
        self.count += 1
        longest = MAX_USEFUL_PAUSE_S if useful else MAX_PAUSE_S
        pause = min(FIRST_PAUSE_S * 2.0 ** min(self.count - 1, 16), longest)
        return pause * (1.0 - JITTER + 2.0 * JITTER * self.random())

    @property
    def is_worth_logging(self) -> bool:
        return is_worth_logging(self.count)


def is_worth_logging(count: int) -> bool:
    """Return whether to log an event for the ``count``-th time: the first three times, then at each
    doubling."""
    return count <= 3 or count & (count - 1) == 0

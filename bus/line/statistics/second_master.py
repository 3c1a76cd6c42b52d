"""Whether another host sends on the same wire. Pure.

A host does not receive the requests of another, only what the units respond to them: frames that come
beside the response to its own request, or while it awaits none. A unit with a wrong address is not that: it
responds in the place of the one that was requested. Nor is a unit that responds late, however late: it sends
as many responses as it had requests. And what a unit sends while it is requested may be its own fault. Two
hosts that write would set each other's speeds, so this one stops writing, but for what stops a unit.
"""

from __future__ import annotations

from collections import Counter, deque

from bus.instants import Monotonic

MIN_RESPONSES = 3
"""Fewer are chance."""
WITHIN_S = 2.0
CLEAR_AFTER_S = 10.0
"""After so long without one it writes again."""
MAX_OUTSTANDING = 3
"""A unit that was off had many requests, and sends no more responses late than this."""


class SecondMaster:
    """``note`` each unrequested response; ``is_present`` while nothing is to be written."""

    def __init__(self) -> None:
        self._noted: deque[Monotonic] = deque(maxlen=MIN_RESPONSES)
        self._until: Monotonic | None = None
        self._outstanding: Counter[int] = Counter()
        """Requests of this host that a unit has not responded to."""

    def requested(self, unit: int) -> None:
        """This host sent a request."""
        self._outstanding[unit] = min(self._outstanding[unit] + 1, MAX_OUTSTANDING)

    def responded(self, unit: int) -> None:
        """A unit responded, in time or late."""
        self._outstanding[unit] = max(self._outstanding[unit] - 1, 0)

    def explains(self, unit: int) -> bool:
        """Whether a response of a unit may be one to an earlier request of this host, which it then counts
        as."""
        is_explained = self._outstanding[unit] > 0
        if is_explained:
            self.responded(unit)
        return is_explained

    def note(self, now: Monotonic) -> None:
        """A unit responded to what this host did not request."""
        self._noted.append(now)
        is_frequent = len(self._noted) == MIN_RESPONSES and now - self._noted[0] <= WITHIN_S
        if is_frequent or self.is_present(now):
            self._until = now + CLEAR_AFTER_S

    def is_present(self, now: Monotonic) -> bool:
        """Whether another host is on the wire."""
        return self._until is not None and now < self._until

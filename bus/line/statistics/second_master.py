"""Whether another host sends on the same wire. Pure.

A host does not receive the requests of another, only what the units respond to them: frames that come
beside the response to its own request, or while it awaits none. A unit with a wrong address is not that: it
responds in the place of the one that was requested. Nor is a unit that responds late: it sends as many
responses as it had requests, and where a device server or its network stood still, all of them at once. And
what a unit sends while it is requested may be its own fault. Two hosts that write would set each other's
speeds, so this one stops writing, but for what stops a unit.
"""

from __future__ import annotations

from collections import defaultdict, deque

from bus.instants import Monotonic

MIN_RESPONSES = 3
"""Fewer are chance."""
WITHIN_S = 2.0
CLEAR_AFTER_S = 10.0
"""After so long without one it writes again."""
MAX_OUTSTANDING = 16
LATE_WITHIN_S = 60.0
"""How many responses of a unit may be late, and by how much. A unit without a response is polled at most ten
times in a minute, so a connection that stood still as long delivers no response too many."""


class SecondMaster:
    """``note`` each unrequested response; ``is_present`` while nothing is to be written."""

    def __init__(self) -> None:
        self.noted = 0
        """Responses that no request of this host explains, since the worker started."""
        self._noted: deque[Monotonic] = deque(maxlen=MIN_RESPONSES)
        self._until: Monotonic | None = None
        self._outstanding: defaultdict[int, deque[Monotonic]] = defaultdict(
            lambda: deque(maxlen=MAX_OUTSTANDING)
        )
        """By unit, when this host sent each request that the unit has not responded to."""

    def requested(self, unit: int, now: Monotonic) -> None:
        """This host sent a request."""
        self._outstanding[unit].append(now)

    def responded(self, unit: int) -> None:
        """A unit responded to the newest request."""
        if self._outstanding[unit]:
            self._outstanding[unit].pop()

    def explains(self, unit: int, now: Monotonic) -> bool:
        """Whether a response of a unit may be one to an earlier request of this host, which it then counts
        as."""
        outstanding = self._outstanding[unit]
        while outstanding and now - outstanding[0] > LATE_WITHIN_S:
            outstanding.popleft()
        if outstanding:
            outstanding.popleft()
            return True
        return False

    def note(self, now: Monotonic) -> None:
        """A unit responded to what this host did not request."""
        self.noted += 1
        self._noted.append(now)
        is_frequent = len(self._noted) == MIN_RESPONSES and now - self._noted[0] <= WITHIN_S
        if is_frequent or self.is_present(now):
            self._until = now + CLEAR_AFTER_S

    def is_present(self, now: Monotonic) -> bool:
        """Whether another host is on the wire."""
        return self._until is not None and now < self._until

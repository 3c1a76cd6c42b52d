"""Whether another host sends on the same wire. Pure.

A host does not receive the requests of another, only what the units respond to them: frames that come
beside the response to its own request, or while it awaits none. A unit with a wrong address is not that: it
responds in the place of the one that was requested. Two hosts that write would set each other's speeds, so
this one stops writing, but for what stops a unit.
"""

from __future__ import annotations

from collections import deque

from bus.instants import Monotonic

MIN_RESPONSES = 3
"""Fewer are chance."""
WITHIN_S = 2.0
CLEAR_AFTER_S = 10.0
"""After so long without one it writes again."""


class SecondMaster:
    """``note`` each unrequested response; ``is_present`` while nothing is to be written."""

    def __init__(self) -> None:
        self._noted: deque[Monotonic] = deque(maxlen=MIN_RESPONSES)
        self._until: Monotonic | None = None

    def note(self, now: Monotonic) -> None:
        """A unit responded to what this host did not request."""
        self._noted.append(now)
        is_frequent = len(self._noted) == MIN_RESPONSES and now - self._noted[0] <= WITHIN_S
        if is_frequent or self.is_present(now):
            self._until = now + CLEAR_AFTER_S

    def is_present(self, now: Monotonic) -> bool:
        """Whether another host is on the wire."""
        return self._until is not None and now < self._until

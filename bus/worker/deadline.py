"""The app's clock, known by the least delay of what it says. Pure.

A message arrives later than it was sent, never earlier, so the least difference between the two clocks
is the nearest to the truth. A deadline is moved by it, so a command held up on the way is seen to be late.

The least is taken over a time on *this* side's clock, never over a count of messages: after a stall many
arrive at once, all late, and they must not push out what is known to be true. A clock of the app that was
set back is so believed after two windows only; until then commands come too late, which harms nobody.
"""

from __future__ import annotations

from math import inf

WINDOW_S = 10.0


class AppClock:
    """Times in epoch seconds; ``received_at`` on the worker's clock, ``app_time`` on the app's."""

    def __init__(self) -> None:
        self._window_began = -inf
        self._least = inf
        self._least_before = inf

    def heard(self, app_time: float, received_at: float) -> None:
        """The app said what time it is."""
        if not 0 <= received_at - self._window_began <= WINDOW_S:
            self._window_began = received_at
            self._least_before, self._least = self._least, inf
        self._least = min(self._least, received_at - app_time)

    def here(self, app_time: float) -> float:
        """The moment ``app_time`` of the app on the worker's clock; the same while it said nothing."""
        least = min(self._least, self._least_before)
        return app_time if least == inf else app_time + least

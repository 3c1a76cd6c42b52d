"""The app's clock, known by the least delay of what it says. Pure.

A message arrives later than it was sent, never earlier, so the least difference between the two clocks
is the nearest to the truth. A deadline is moved by it, so a command held up on the way is seen to be late.
"""

from __future__ import annotations

from collections import deque

KEPT = 10
STEPPED_S = 0.5
STEPS_TO_BELIEVE = 3
"""So many messages in a row that all came later than they could: the app's clock was set back."""


class AppClock:
    """Times in epoch seconds; ``received_at`` on the worker's clock, ``app_time`` on the app's."""

    def __init__(self) -> None:
        self._differences: deque[float] = deque(maxlen=KEPT)

    def heard(self, app_time: float, received_at: float) -> None:
        """The app said what time it is."""
        self._differences.append(received_at - app_time)
        newest = list(self._differences)[-STEPS_TO_BELIEVE:]
        if len(newest) == STEPS_TO_BELIEVE and min(newest) > min(self._differences) + STEPPED_S:
            self._differences = deque(newest, maxlen=KEPT)

    def here(self, app_time: float) -> float:
        """The moment ``app_time`` of the app on the worker's clock."""
        return app_time + min(self._differences, default=0.0)

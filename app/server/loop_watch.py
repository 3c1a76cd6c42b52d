"""Whether the event loop stood still: a stall of this process, or of the machine under it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from math import inf

TICK_S = 0.05
SOON_S = 0.001
"""After a stall: separates what arrives after it from what arrived during it."""


class LoopWatch:
    """Ticks on the loop that :meth:`start` is called on. ``now``: a monotonic clock."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.now = now
        self._before_last = self._last = -inf
        self._timer: asyncio.TimerHandle | None = None

    @property
    def polled_after(self) -> float:
        """A moment since when the loop has polled all its sockets at least once before it delivered what it
        delivers now, which was therefore not there yet; monotonic, -inf while that is not known.

        The last tick may be of this very turn of the loop, before its poll; the one before it never is.
        """
        return self._before_last

    def start(self) -> None:
        """Begin; the ticks end with :meth:`stop`."""
        self._tick()

    def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _tick(self) -> None:
        now = self.now()
        stood_still = now - self._last > 2 * TICK_S
        self._before_last, self._last = self._last, now
        self._timer = asyncio.get_running_loop().call_later(SOON_S if stood_still else TICK_S, self._tick)

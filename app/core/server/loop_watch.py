"""Notices whether the event loop stood still: a stall of this process, or of the machine under it."""

from __future__ import annotations

import asyncio

from bus.instants import Monotonic, MonotonicClock, monotonic_now

TICK_S = 0.05
SOON_S = 0.001
"""After a stall: separates what arrives after it from what arrived during it."""
ORDINARY_TURN_S = 0.15
"""A loop that was last seen to turn so short a time ago has not stood still."""


class LoopWatch:
    """Ticks on the loop that :meth:`start` is called on. ``since``: when the first client can have come, on
    the monotonic clock ``now``."""

    def __init__(self, since: Monotonic, now: MonotonicClock = monotonic_now) -> None:
        self.now = now
        self._before_last = self._last = since
        self._timer: asyncio.TimerHandle | None = None

    @property
    def polled_after(self) -> Monotonic:
        """A moment since when the loop has polled all its sockets at least once before it delivered what it
        delivers now, which was therefore not there yet.

        The last tick may be of this very turn of the loop, before its poll; the one before it never is.
        """
        return self._before_last

    def earliest(self) -> Monotonic:
        """Return the earliest moment at which what the loop delivers now can have arrived."""
        now = self.now()
        return now if now - self.polled_after <= ORDINARY_TURN_S else self.polled_after

    def start(self) -> None:
        """Begin to tick; :meth:`stop` ends the ticks."""
        self._tick()

    def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _tick(self) -> None:
        now = self.now()
        stood_still = now - self._last > 2 * TICK_S
        self._before_last, self._last = self._last, now
        self._timer = asyncio.get_running_loop().call_later(SOON_S if stood_still else TICK_S, self._tick)

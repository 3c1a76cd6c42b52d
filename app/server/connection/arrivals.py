"""The earliest arrival time of what a connection delivers. Pure: all times are monotonic and passed in.

A stalled process, a full backlog before it accepts, and a request ahead of another in one connection keep
bytes in the kernel, which reports the waiting time of the last of them only. Of the first of them it is
certain only that they were not there when the connection was last found empty.
"""

from __future__ import annotations

from math import inf

FULL_READ_BYTES = 64 * 1024
"""A read of so much may have left some behind: the buffers of asyncio and uvloop hold more than this."""
ORDINARY_TURN_S = 0.15
"""A loop that was last seen to turn so short a time ago has not stood still."""


class ConnectionArrivals:
    """One connection, accepted at ``accepted_at`` and open since ``opened_at``."""

    def __init__(self, opened_at: float, accepted_at: float) -> None:
        self._empty_at = opened_at
        self._polled_from = accepted_at
        self._arrived_at = opened_at

    def received(self, now: float, size: int, *, polled_after: float, waited_s: float) -> float:
        """Return the earliest time at which these ``size`` bytes can have arrived.

        ``polled_after``: the loop has polled every open socket since; ``waited_s``: how long the kernel has
        had the last of them, 0 where it is not reported.
        """
        self._arrived_at = min(self._not_there_at(now, polled_after), now - waited_s)
        self._empty_at = now if size < FULL_READ_BYTES else self._arrived_at
        return self._arrived_at

    def paused(self) -> None:
        """What comes from now on is left in the kernel."""
        self._empty_at = self._arrived_at
        self._polled_from = inf

    def resumed(self, now: float) -> None:
        """The connection is read again."""
        if self._polled_from == inf:
            self._polled_from = now

    def _not_there_at(self, now: float, polled_after: float) -> float:
        if self._polled_from > polled_after:
            return self._empty_at
        return now if now - polled_after <= ORDINARY_TURN_S else max(self._empty_at, polled_after)

"""The offset of another machine's clock, from messages that carry their time of sending. Pure.

A message arrives later than it was sent, never earlier, so the least difference between the two clocks is the
best estimate (the clock filter of NTP, RFC 5905, 10).

The least is taken over a time on *this* side's clock, not over a count of messages: after a stall many arrive
at once, all late, and they must not displace the good samples. A clock that was set ahead is therefore
followed at once, and one that was set back after two windows.
"""

from __future__ import annotations

from math import inf

from bus.instants import UnixTime

WINDOW_S = 10.0


class ClockOffset:
    """Estimates what to add to the other machine's times. Times are seconds since the epoch."""

    def __init__(self) -> None:
        self._window_began = UnixTime(-inf)
        self._least = inf
        self._least_before = inf

    def observe(self, sent_at: UnixTime, received_at: UnixTime) -> None:
        """Take in one message. ``sent_at`` is of the other clock, ``received_at`` of this one."""
        if not 0 <= received_at - self._window_began <= WINDOW_S:
            self._window_began = received_at
            self._least_before, self._least = self._least, inf
        self._least = min(self._least, received_at - sent_at)

    @property
    def seconds(self) -> float | None:
        """The estimate; None before the first message."""
        least = min(self._least, self._least_before)
        return None if least == inf else least

    def here(self, time: UnixTime) -> UnixTime:
        """The moment ``time`` of the other clock on this one; the same before the first message."""
        return time + (self.seconds or 0.0)

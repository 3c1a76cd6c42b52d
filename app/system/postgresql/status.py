"""The state of the publisher: how far behind the plant's database is, and why."""

from __future__ import annotations

from dataclasses import dataclass

from bus.instants import UnixTime
from bus.messages import Message, number

CLOCK_SAID_S = 60.0
"""A difference of the clocks that is said."""


@dataclass(frozen=True, slots=True)
class PublisherStatus:
    """``until``: up to when everything that was stored then is published; ``fault``: why nothing is published
    now; ``clock_ahead_s``: of the database; ``rows``: sent since the start."""

    place: str
    until: UnixTime
    fault: Message | None = None
    clock_ahead_s: float = 0.0
    rows: int = 0

    def lag_s(self, now: UnixTime) -> float:
        """Return for how many seconds nothing, or not everything, was published."""
        return max(0.0, float(now - self.until))

    def state(self, now: UnixTime) -> Message:
        """State in a sentence how up to date the database is."""
        seconds = number(f"{self.lag_s(now):.0f}")
        if self.fault is not None:
            return Message.of("publisher_lacks", reason=self.fault, seconds=seconds)
        return Message.of("publisher_has", place=self.place, seconds=seconds)

    @property
    def notice(self) -> Message | None:
        """Return why nothing is published, or that the clock of the database differs; None where neither is
        so."""
        if self.fault is not None:
            return self.fault
        if abs(self.clock_ahead_s) < CLOCK_SAID_S:
            return None
        ahead = number(f"{self.clock_ahead_s:+.0f}")
        return Message.of("publisher_clock", place=self.place, seconds=ahead)

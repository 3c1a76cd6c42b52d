"""Which month of events is to be archived. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from zoneinfo import ZoneInfo

from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class Month:
    """A month by the clock of the site; ``number`` counts months since the year 0."""

    number: int
    zone: ZoneInfo

    @property
    def name(self) -> str:
        return f"{self.number // 12:04d}-{self.number % 12 + 1:02d}"

    @property
    def begins(self) -> UnixTime:
        return UnixTime(datetime(self.number // 12, self.number % 12 + 1, 1, tzinfo=self.zone).timestamp())

    def after(self, months: int) -> Month:
        return Month(self.number + months, self.zone)


def month_of(at: UnixTime, zone: ZoneInfo) -> Month:
    """The month in which a time is."""
    local = datetime.fromtimestamp(float(at), zone)
    return Month(local.year * 12 + local.month - 1, zone)


def months_due(oldest: UnixTime, now: UnixTime, keep: int, zone: ZoneInfo) -> list[Month]:
    """The months that are over for more than ``keep`` months, from that of the oldest event."""
    kept = month_of(now, zone).after(-keep)
    first = month_of(oldest, zone)
    return [first.after(months) for months in range(max(0, kept.number - first.number))]


def is_known(at: UnixTime, now: UnixTime) -> bool:
    """Whether the time of an event can be right: one after ``now`` is of a clock that was wrong."""
    return UnixTime(0) < at <= now

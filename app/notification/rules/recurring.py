"""Maintenance that recurs, by the clock of the site. Pure.

One lasts from the first moment at which the clock shows its start, or goes on after it, to the first at which
it does so with its end. When the clocks change it is shorter or longer; where both are skipped there is none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date, datetime, time, timedelta
from zoneinfo import ZoneInfo

from app.notification.rules.notices import QuietSpan
from bus.instants import UnixTime

_DAY = timedelta(days=1)
_MINUTE = timedelta(minutes=1)


@dataclass(frozen=True, slots=True)
class RecurringMaintenance:
    """On each of ``days`` (Monday: 0) from minute ``starts`` of the day to minute ``ends``; where that is not
    later, on the next day. ``until``: the last day on which one begins; ``buses``: None is everything."""

    days: frozenset[int]
    starts: int
    ends: int
    until: date
    buses: tuple[str | None, ...]
    reason: str

    def spans(self, first: date, last: date, zone: ZoneInfo) -> Iterator[QuietSpan]:
        """Those that begin on a day from ``first`` to ``last``, in order."""
        for number in range((min(last, self.until) - first).days + 1):
            day = first + number * _DAY
            if day.weekday() in self.days:
                starts = first_at(day, self.starts, zone)
                ends = first_at(day + _DAY if self.ends <= self.starts else day, self.ends, zone)
                if starts < ends:
                    yield from (QuietSpan(starts, ends, bus) for bus in self.buses)


def first_at(day: date, minute: int, zone: ZoneInfo) -> UnixTime:
    """The first moment at which the clock shows a minute of a day; where the clocks skip it, at which they go
    on."""
    local = datetime.combine(day, time()) + minute * _MINUTE
    while True:
        at = local.replace(tzinfo=zone).timestamp()
        if datetime.fromtimestamp(at, zone).replace(tzinfo=None) == local:
            return UnixTime(at)
        local += _MINUTE

"""Maintenance that recurs, by the clock of the site. Pure.

One lasts from the first moment at which the clock shows its start, or goes on after it, to the first at which
it does so with its end. When the clocks change it is shorter or longer; where both are skipped there is none.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date, datetime, time, timedelta
from zoneinfo import ZoneInfo

from app.records.notification.rules.notices import QuietSpan
from app.records.notification.settings import DAYS, MaintenanceSettings, minute_of_day
from bus.instants import UnixTime

_DAY = timedelta(days=1)
_MINUTE = timedelta(minutes=1)


def recurring_spans(
    maintenance: MaintenanceSettings, first: date, last: date, zone: ZoneInfo
) -> Iterator[QuietSpan]:
    """The spans of a recurring maintenance that begin on a day from ``first`` to ``last``, in order."""
    starts, ends = minute_of_day(maintenance.starts), minute_of_day(maintenance.ends)
    for number in range((min(last, maintenance.until) - first).days + 1):
        day = first + number * _DAY
        if DAYS[day.weekday()] in maintenance.days:
            begins = first_at(day, starts, zone)
            over_at = first_at(day + _DAY if ends <= starts else day, ends, zone)
            if begins < over_at:
                yield from (QuietSpan(begins, over_at, bus) for bus in maintenance.buses or (None,))


def first_at(day: date, minute: int, zone: ZoneInfo) -> UnixTime:
    """The first moment at which the clock shows a minute of a day; where the clocks skip it, at which they go
    on."""
    local = datetime.combine(day, time()) + minute * _MINUTE
    while True:
        at = local.replace(tzinfo=zone).timestamp()
        if datetime.fromtimestamp(at, zone).replace(tzinfo=None) == local:
            return UnixTime(at)
        local += _MINUTE

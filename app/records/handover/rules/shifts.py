"""Shifts by the clock of the site, and what a sheet or a report is about. Pure.

A shift lasts from one start to the next. Where the clocks change, one is an hour shorter or longer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import NamedTuple
from zoneinfo import ZoneInfo

from bus.instants import UnixTime

DAY = timedelta(days=1)


@dataclass(frozen=True, slots=True)
class Shift:
    """From ``start`` up to ``end``, which is the start of the next one."""

    start: UnixTime
    end: UnixTime

    def holds(self, at: UnixTime) -> bool:
        return self.start <= at < self.end


def shift_at(at: UnixTime, starts: Sequence[int], zone: ZoneInfo) -> Shift:
    """Return the shift that a moment is in. ``starts``: minutes after local midnight, at least one."""
    edges = _edges(_day(at, zone), starts, zone)
    later = next(index for index, edge in enumerate(edges) if edge > at)
    return Shift(edges[later - 1], edges[later])


def shifts_until(at: UnixTime, starts: Sequence[int], zone: ZoneInfo) -> Iterator[Shift]:
    """Yield the shift that a moment is in, and those before it, newest first."""
    shift = shift_at(at, starts, zone)
    while True:
        yield shift
        shift = shift_at(shift.start - 1.0, starts, zone)


def instant_of(minute: int, shift: Shift, zone: ZoneInfo) -> UnixTime | None:
    """Return the first moment of a shift at which the clock shows this minute of the day; None: it never
    does."""
    first = datetime.combine(_day(shift.start, zone), datetime.min.time())
    for days in range(3):
        for fold in (0, 1):
            local = (first + timedelta(days=days, minutes=minute)).replace(tzinfo=zone, fold=fold)
            at = UnixTime(local.timestamp())
            if shift.holds(at) and _clock(at, zone) == minute:
                return at
    return None


def site_time(at: UnixTime, zone: ZoneInfo) -> str:
    """Return a moment by the clock of the site, for messages."""
    return datetime.fromtimestamp(float(at), zone).strftime("%Y-%m-%d %H:%M")


def _edges(day: date, starts: Sequence[int], zone: ZoneInfo) -> list[UnixTime]:
    """Return every start from the day before to the day after next, in order. One that the clocks skip is
    where they go on."""
    midnights = (datetime.combine(day + days * DAY, datetime.min.time()) for days in (-2, -1, 0, 1, 2))
    return sorted(
        {
            UnixTime((midnight + timedelta(minutes=minute)).replace(tzinfo=zone).timestamp())
            for midnight in midnights
            for minute in starts
        },
        key=float,
    )


def _day(at: UnixTime, zone: ZoneInfo) -> date:
    return datetime.fromtimestamp(float(at), zone).date()


def _clock(at: UnixTime, zone: ZoneInfo) -> int:
    local = datetime.fromtimestamp(float(at), zone)
    return 60 * local.hour + local.minute


class Scope(NamedTuple):
    """``bus`` None: the site; ``unit`` None: all units of the bus."""

    bus: str | None = None
    unit: int | None = None

    def holds(self, bus: str | None, unit: int | None) -> bool:
        """Return whether what is about a place is about this."""
        return self.bus in (None, bus) and self.unit in (None, unit)

    def concerns(self, bus: str | None, unit: int | None) -> bool:
        """Return whether people of this have to know what is about a place: also of its line, and of the
        site."""
        return (
            bus is None
            or self.bus is None
            or (bus == self.bus and (unit is None or self.unit in (None, unit)))
        )

    def conditions(self, table: str = "") -> tuple[str, list[object]]:
        """SQL to append to a query of a table with these columns, and its values."""
        named = [(name, value) for name, value in self._asdict().items() if value is not None]
        return "".join(f" AND {table}{name} = ?" for name, _ in named), [value for _, value in named]


EVERYTHING = Scope()

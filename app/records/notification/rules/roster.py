"""Who of a group is on duty. Pure: local time in. Minutes are counted from Monday 00:00, 10,080 in a week."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime

MINUTES_OF_DAY = 24 * 60
MINUTES_OF_WEEK = 7 * MINUTES_OF_DAY


@dataclass(frozen=True, slots=True)
class DutyPeriod:
    """Each of ``days`` (Monday: 0) from the minute ``starts`` of the day on, ``minutes`` long."""

    days: frozenset[int]
    starts: int
    minutes: int
    to: tuple[str, ...]

    def covers(self, minute: int) -> bool:
        """Whether it includes a minute of the week."""
        return any(
            (minute - day * MINUTES_OF_DAY - self.starts) % MINUTES_OF_WEEK < self.minutes
            for day in self.days
        )


@dataclass(frozen=True, slots=True)
class DutyRoster:
    """``always``: addresses that are notified at any time; ``periods``: the others."""

    always: tuple[str, ...] = ()
    periods: tuple[DutyPeriod, ...] = ()

    def on_duty(self, local: datetime) -> tuple[str, ...]:
        """The addresses at a local time. In a gap these are all of the group: better too many than none."""
        minute = minute_of_week(local)
        present = (*self.always, *(to for each in self.periods if each.covers(minute) for to in each.to))
        return _each_once(present or self.addresses())

    def addresses(self) -> tuple[str, ...]:
        """Every address of the group."""
        return _each_once((*self.always, *(to for each in self.periods for to in each.to)))

    def gaps(self) -> list[tuple[int, int]]:
        """The spans of a week in which no address is on duty: first minute, and the first after it. A gap
        over the end of the week is given in two."""
        if self.always:
            return []
        open_minutes = [
            minute
            for minute in range(MINUTES_OF_WEEK)
            if not any(each.covers(minute) for each in self.periods)
        ]
        return _spans(open_minutes)


def minute_of_week(local: datetime) -> int:
    """Return the minute of the week; Monday 00:00 is 0."""
    return local.weekday() * MINUTES_OF_DAY + local.hour * 60 + local.minute


def _each_once(addresses: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(addresses))


def _spans(minutes: list[int]) -> list[tuple[int, int]]:
    spans: list[tuple[int, int]] = []
    for minute in minutes:
        if spans and spans[-1][1] == minute:
            spans[-1] = (spans[-1][0], minute + 1)
        else:
            spans.append((minute, minute + 1))
    return spans

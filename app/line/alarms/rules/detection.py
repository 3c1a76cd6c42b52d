"""Rules of detection: limits with a deadband, rates of change, counts per minute, first-out and suppression.

Pure: numbers are in the units of the value, and the time is passed in.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache

from app.line.conditions.condition import CountPredicate, SuppressionGroup, Tuning
from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class LimitRule:
    """A limit with a deadband. ``above`` and ``below``: where the condition begins; None: no such limit."""

    above: int | None
    below: int | None
    deadband: int = 0

    def holds(self, value: int, active: bool) -> bool:
        """Return whether a value is beyond a limit. An active condition ends only when the value is back by
        more than the deadband."""
        deadband = self.deadband if active else 0
        if self.above is not None and value > self.above - deadband:
            return True
        return self.below is not None and value < self.below + deadband


@lru_cache(1024)  # Decimals cost 4 µs with each value of each unit
def limits_of(tuning: Tuning, full_scale: int) -> LimitRule:
    """Return the limits of an alarm in the counts of its value."""

    def raw(percent: Decimal | None) -> int | None:
        return None if percent is None else round(percent * full_scale / 100)

    above, below = raw(tuning.above_percent), raw(tuning.below_percent)
    return LimitRule(max(1, above or 0), below, raw(tuning.deadband_percent) or 0)


@dataclass(slots=True)
class ChangeRate:
    """The rate of change of a value, over at least ``SPAN_S`` seconds."""

    SPAN_S = 1.0
    _at: float | None = None
    _value: int = 0
    _per_s: float | None = None

    def see(self, value: int, at: float) -> float | None:
        """Return the change per second up to a reading; None while it is not known."""
        if self._at is None or at < self._at:
            self._at, self._value = at, value
        elif at - self._at >= self.SPAN_S:
            self._per_s = abs(value - self._value) / (at - self._at)
            self._at, self._value = at, value
        return self._per_s

    def forget(self) -> None:
        """Forget the rate: the value was not known for a while."""
        self._at = self._per_s = None


COUNTED_S = 60.0


@dataclass(slots=True)
class CountWindow:
    """Counts a total and its faults in windows of a minute. None until the first window is over."""

    total: int | None = None
    faults: int | None = None
    _at: UnixTime | None = None
    _from: tuple[int, int] = (0, 0)

    def judged(self, holds: CountPredicate) -> bool | None:
        """Return whether a condition holds by the last window; None until one is over."""
        return None if self.total is None or self.faults is None else holds(self.total, self.faults)

    def restart(self) -> None:
        """Count from the next counters on."""
        self._at = None

    def see(self, total: int, faults: int, at: UnixTime) -> None:
        """Add the present counters. A worker that was started again counts from zero."""
        is_restarted = total < self._from[0] or faults < self._from[1]
        if self._at is None or is_restarted or at < self._at:
            self._at, self._from = at, (total, faults)
        elif at - self._at >= COUNTED_S:
            self.total, self.faults = total - self._from[0], faults - self._from[1]
            self._at, self._from = at, (total, faults)


DISTURBANCE_S = 5.0
"""Alarms that rise within this time of the first belong to one disturbance."""


@dataclass(slots=True)
class FirstOut:
    """Finds the first alarm of a disturbance of one bus. An alarm alone is not marked."""

    _first: str | None = None
    _at: UnixTime = UnixTime(0.0)

    def rise(self, alarm: str, at: UnixTime) -> str | None:
        """Add an alarm that is annunciated, and return the first of its disturbance; None while it is
        alone."""
        if self._first is None or not 0 <= at - self._at <= DISTURBANCE_S:
            self._first, self._at = alarm, at
            return None
        return self._first if alarm != self._first else None


@dataclass(frozen=True, slots=True)
class Suppressors:
    """The conditions of one bus that suppress alarms now."""

    groups: Collection[SuppressionGroup] = ()
    """The groups that conditions of the bus suppress."""
    at_rest: bool = False
    estops: Collection[int] = ()
    """The units whose emergency stop is active."""

    def suppress(self, group: SuppressionGroup | None, unit: int | None) -> bool:
        """Return whether an alarm of this group and unit is suppressed."""
        return group in self.groups or (group == "speed" and (self.at_rest or unit in self.estops))


def is_at_rest(commanded: Iterable[int | None]) -> bool:
    """Return whether zero is commanded to every unit; a unit that was never read is no proof of rest."""
    speeds = list(commanded)
    return bool(speeds) and all(speed == 0 for speed in speeds)

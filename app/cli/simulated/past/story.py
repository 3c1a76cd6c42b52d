"""What a simulated line did in the day before: its production, and what interrupted it. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

from bus.catalogue import numbers
from bus.instants import UnixTime
from bus.simulator.demo import DemoLine
from bus.simulator.unit import Unit

DAY_S, HOUR_S = 86_400.0, 3600.0
MAX_UNITS = 8
"""How many units have readings: a longer line would take seconds to write."""
GAP_S = 5.0
"""Between the last reading of the past and the first of the demo."""


class Phase(NamedTuple):
    """From so many hours before now on, the line ran at this part of its setpoints."""

    hours_ago: float
    share: float


PHASES = (Phase(24.0, 0.75), Phase(13.6, 0.0), Phase(13.2, 1.0))
"""Primer, a change of recipe at standstill, and the present speed."""


@dataclass(frozen=True, slots=True)
class Incident:
    """What stopped a unit, or its link; acknowledged after so many seconds, or not at all."""

    code: Literal["estop_active", "unit_offline"]
    unit: int
    began: UnixTime
    lasted_s: float
    acknowledged_after_s: float | None

    @property
    def ended(self) -> UnixTime:
        return self.began + self.lasted_s

    @property
    def acknowledged_at(self) -> UnixTime | None:
        after_s = self.acknowledged_after_s
        return None if after_s is None else self.began + after_s

    def holds(self, at: UnixTime) -> bool:
        return self.began <= at < self.ended


_INCIDENTS: tuple[tuple[Literal["estop_active", "unit_offline"], int, float, float, float | None], ...] = (
    ("estop_active", 3, 19.3, 240.0, 42.0),
    ("estop_active", 1, 16.8, 35.0, 20.0),
    ("unit_offline", 5, 9.1, 130.0, 75.0),
    ("estop_active", 8, 6.4, 95.0, 30.0),
    ("estop_active", 3, 5.7, 60.0, 25.0),
    ("unit_offline", 2, 2.6, 48.0, 90.0),
    ("estop_active", 4, 0.7, 50.0, None),
)


class Stretch(NamedTuple):
    """A time in which nothing about a unit changed: the part of its setpoint that it ran at, and why not."""

    begins: UnixTime
    ends: UnixTime
    share: float
    incident: Incident | None


@dataclass(frozen=True, slots=True)
class Past:
    """The day before ``now``."""

    now: UnixTime
    units: tuple[Unit, ...]
    names: tuple[str, ...]
    incidents: tuple[Incident, ...]

    @property
    def begins(self) -> UnixTime:
        return self.now - DAY_S

    def hours_ago(self, hours: float) -> UnixTime:
        return self.now - hours * HOUR_S

    def stretches(self, unit: int) -> Iterator[Stretch]:
        """The day of a unit, in order."""
        ends = self.now - GAP_S
        phases = [(self.hours_ago(phase.hours_ago), phase.share) for phase in PHASES]
        incidents = [each for each in self.incidents if each.unit == unit]
        edges = {at for at, _ in phases} | {at for each in incidents for at in (each.began, each.ended)}
        times = [*sorted(edges), ends]
        for begin, end in pairwise(times):
            share = [share for at, share in phases if at <= begin][-1]
            yield Stretch(begin, end, share, next((each for each in incidents if each.holds(begin)), None))


def past_of(line: DemoLine, now: UnixTime) -> Past:
    """The past of a line; units that it does not have were in no incident."""
    incidents = (
        Incident(code, unit, now - hours * HOUR_S, lasted, acknowledged)
        for code, unit, hours, lasted, acknowledged in _INCIDENTS
        if unit <= len(line.settings)
    )
    return Past(now, tuple(line.plant.units), tuple(unit.name for unit in line.settings), tuple(incidents))


def setpoint_of(unit: Unit, share: float) -> int:
    """The setpoint of a unit while the line runs at this part: a follower's ratio stays."""
    return unit.setpoint if unit.follows else round(unit.memory[numbers.SPEED_SETPOINT] * share)

"""What predicates of conditions judge: facts as plain values, or what they read of the live state. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from app.line.conditions.draw import Draw
from bus.catalogue.numbers import FOLLOWER_MODE
from bus.catalogue.status import StatusBits
from bus.catalogue.values import is_follower
from bus.contract import BusFigures, ParameterValue, Reading
from bus.settings import BusSettings, UnitSettings


class UnitFacts(NamedTuple):
    """A unit by a reading. ``motion``: a MotionState; ``is_late``: a response is really overdue."""

    bits: StatusBits
    motion: str
    commanded: int | None
    actual: int | None
    is_late: bool = False


class LinkFacts(NamedTuple):
    """The link of a unit. ``is_alone``: of several units, no other has responded since it was lost."""

    bus_is_readable: bool
    is_lost: bool
    is_online: bool
    is_alone: bool


class BusFacts(NamedTuple):
    """A bus. ``units``: how many it has; ``lost``: those that do not respond; ``unread``: those that have not
    responded yet and still have their time; ``scan_s``: of a scan, None while it is not measured;
    ``longest_scan_s``: of one in which each unit takes its full turnaround."""

    worker_is_lost: bool
    port_is_closed: bool
    units: int
    lost: int
    unread: int
    scan_s: float | None
    longest_scan_s: float

    @property
    def is_readable(self) -> bool:
        return not (self.worker_is_lost or self.port_is_closed)

    @property
    def has_no_response(self) -> bool:
        """Whether none of several units responds; the only unit of a bus is named itself."""
        return self.units > 1 and self.lost + self.unread == self.units


class MotionValue(Protocol):
    """How a unit moves."""

    @property
    def state(self) -> str: ...


class UnitValues(Protocol):
    """The live state of a unit."""

    @property
    def settings(self) -> UnitSettings: ...
    @property
    def motion(self) -> MotionValue: ...
    @property
    def staged(self) -> int | None: ...
    @property
    def reading(self) -> Reading | None: ...
    @property
    def parameters(self) -> Mapping[int, ParameterValue]: ...
    def parameter_raw(self, number: int, /) -> int | None: ...


class BusValues(Protocol):
    """The live state of a bus."""

    @property
    def settings(self) -> BusSettings: ...
    @property
    def figures(self) -> BusFigures | None: ...
    @property
    def units(self) -> Mapping[int, UnitValues]: ...


LimitCheck = Callable[[int, int], bool]
"""Takes a value and its full scale; whether the value passes the limits of the alarm."""
StatusPredicate = Callable[[StatusBits], bool]
ReadingPredicate = Callable[[UnitFacts], bool]
ValuePredicate = Callable[[BusValues, UnitValues, Reading, LimitCheck], bool | None]
ParameterPredicate = Callable[[BusValues, UnitValues], bool | None]
DrawPredicate = Callable[[Draw], bool | None]
LinkPredicate = Callable[[LinkFacts], bool | None]
BusPredicate = Callable[[BusFacts], bool | None]
CountPredicate = Callable[[int, int], bool]
"""Takes how many there were in a minute, and how many of them had a fault."""
StatePredicate = Callable[[str], bool]


def follower(unit: UnitValues) -> bool | None:
    """Whether #8 makes the unit follow a master by a ratio; None while it was not read."""
    mode = unit.parameter_raw(FOLLOWER_MODE)
    return None if mode is None else is_follower(mode)


def reads_ratio(bus: BusValues, unit: UnitValues) -> bool:
    """Whether commanded and actual speed of a unit are ratios to its master, in the dialect of its bus."""
    return bus.settings.follower_speed == "ratio" and bool(follower(unit))

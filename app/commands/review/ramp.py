"""What a new setpoint will do: from where to where, within which range, and for how long. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from app.commands.rules.setpoint import commanded_setpoint
from app.live.state.bus_live import BusLive, UnitLive, follower
from app.live.state.ramp_time import ramp_parameter, ramp_seconds
from bus.catalogue.numbers import ACCELERATION, DECELERATION, MAX_DISPLAY, RATIO_SETPOINT

COARSE_STEPS, FINE_STEPS = 100, 1000
"""A nudge is about a hundredth or a thousandth of the full span."""


@dataclass(frozen=True, slots=True)
class Ramp:
    """``number``: the parameter that sets it, #6 or #7. ``tenths``: its raw value, for the full span (#2);
    ``seconds``: for this change. None where it is not known."""

    number: int
    tenths: int | None
    seconds: float | None


def ramp_of(unit: UnitLive, old: int | None, new: int) -> Ramp | None:
    """The ramp between two raw setpoints; None where nothing changes or the unit follows its master."""
    if old == new or follower(unit):
        return None
    number = ramp_parameter(old, new)
    tenths = None if old is None else unit.parameter_raw(number)
    return Ramp(number, tenths, ramp_seconds(unit, old, new))


def present_setpoint(bus: BusLive, unit: UnitLive) -> int | None:
    """The commanded setpoint; of a follower that shows its speed, the command ratio as last read."""
    known = commanded_setpoint(unit, bus)
    return unit.parameter_raw(RATIO_SETPOINT) if known is None and follower(unit) else known


def ramp_parameters_missing(unit: UnitLive) -> list[int]:
    """Parameters to read before the time of a ramp can be given."""
    return [number for number in (MAX_DISPLAY, ACCELERATION, DECELERATION) if number not in unit.parameters]


def nudges(unit: UnitLive) -> tuple[int, int]:
    """(fine, coarse) raw steps that suit the unit's span."""
    span = 10_000 if follower(unit) else unit.parameter_raw(MAX_DISPLAY) or 10_000
    return _round_number(span / FINE_STEPS), _round_number(span / COARSE_STEPS)


def _round_number(size: float) -> int:
    """The largest of 1, 2, 5, 10, 20, … that is not above ``size``."""
    step = 1
    for candidate in (digit * 10**power for power in range(5) for digit in (1, 2, 5)):
        if candidate <= size:
            step = candidate
    return step

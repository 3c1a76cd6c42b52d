"""What a new setpoint will do: from where to where, within which bounds, and for how long. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from app.commands.limits import Limits
from app.commands.setpoint_range import COMMAND_RATIO, MAX_DISPLAY, setpoint_range
from app.commands.setpoints import commanded_setpoint
from app.commands.words import shown_setpoint
from app.live.state import BusLive, UnitLive, follower
from bus.catalogue.parameter import Parameter
from bus.catalogue.parameters import PARAMETERS

RAMP_UP, RAMP_DOWN = 6, 7
COARSE_STEPS, FINE_STEPS = 100, 1000
"""A nudge is about a hundredth or a thousandth of the full span."""


@dataclass(frozen=True, slots=True)
class Change:
    """One unit's setpoint, before and after. ``seconds``: what its ramp takes, None where not known."""

    unit: int
    name: str
    old_raw: int | None
    new_raw: int
    old: str
    new: str
    lowest: str
    highest: str
    seconds: float | None
    ramp: Parameter


def change_of(bus: BusLive, unit: UnitLive, new_raw: int, limits: Limits) -> Change:
    """What setting ``new_raw`` means for a unit."""
    old_raw = present_setpoint(bus, unit)
    allowed = setpoint_range(unit, limits)
    ramp = RAMP_DOWN if old_raw is not None and new_raw < old_raw else RAMP_UP
    return Change(
        unit=unit.settings.id,
        name=unit.settings.name,
        old_raw=old_raw,
        new_raw=new_raw,
        old=shown_setpoint(old_raw, unit),
        new=shown_setpoint(new_raw, unit),
        lowest=shown_setpoint(allowed.lowest, unit),
        highest=shown_setpoint(allowed.highest, unit),
        seconds=_ramp_seconds(unit, old_raw, new_raw, ramp),
        ramp=PARAMETERS[ramp],
    )


def present_setpoint(bus: BusLive, unit: UnitLive) -> int | None:
    """The commanded setpoint; of a follower that shows its speed, the command ratio as last read."""
    known = commanded_setpoint(unit, bus)
    return unit.parameter_raw(COMMAND_RATIO) if known is None and follower(unit) else known


def ramp_parameters_missing(unit: UnitLive) -> list[int]:
    """What must be read before a ramp's time can be told."""
    return [number for number in (MAX_DISPLAY, RAMP_UP, RAMP_DOWN) if number not in unit.parameters]


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


def _ramp_seconds(unit: UnitLive, old: int | None, new: int, ramp: int) -> float | None:
    span, tenths = unit.parameter_raw(MAX_DISPLAY), unit.parameter_raw(ramp)
    if old is None or not span or tenths is None or follower(unit):
        return None
    return abs(new - old) / span * tenths / 10

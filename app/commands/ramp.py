"""What a new setpoint will do: from where to where, within which bounds, and for how long. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from app.commands.limits import Limits
from app.commands.setpoints import bounds, commanded_setpoint
from app.commands.words import shown_setpoint
from app.live.ramp_time import ramp_seconds
from app.live.state import BusLive, UnitLive, follower
from bus.catalogue.parameter import Parameter
from bus.catalogue.parameters import PARAMETERS

MAX_DISPLAY, COMMAND_RATIO = 2, 37
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
    over_span: bool
    """Above what #2 lets the unit show: it will refuse this itself."""


def change_of(bus: BusLive, unit: UnitLive, new_raw: int, limits: Limits) -> Change:
    """What setting ``new_raw`` means for a unit."""
    old_raw = present_setpoint(bus, unit)
    lowest, highest = sensible_bounds(unit, limits)
    span = unit.parameter_raw(MAX_DISPLAY)
    ramp = RAMP_DOWN if old_raw is not None and new_raw < old_raw else RAMP_UP
    return Change(
        unit=unit.settings.id,
        name=unit.settings.name,
        old_raw=old_raw,
        new_raw=new_raw,
        old=shown_setpoint(old_raw, unit),
        new=shown_setpoint(new_raw, unit),
        lowest=shown_setpoint(lowest, unit),
        highest=shown_setpoint(highest, unit),
        seconds=ramp_seconds(unit, old_raw, new_raw),
        ramp=PARAMETERS[ramp],
        over_span=span is not None and not follower(unit) and new_raw > span,
    )


def present_setpoint(bus: BusLive, unit: UnitLive) -> int | None:
    """The commanded setpoint; of a follower that shows its speed, the command ratio as last read."""
    known = commanded_setpoint(unit, bus)
    return unit.parameter_raw(COMMAND_RATIO) if known is None and follower(unit) else known


def sensible_bounds(unit: UnitLive, limits: Limits) -> tuple[int, int]:
    """Lowest and highest setpoint to print: what may be sent, and no more than the unit can show (#2)."""
    lowest, highest, _ = bounds(unit, limits)
    span = unit.parameter_raw(MAX_DISPLAY)
    return lowest, min(highest, span) if span and not follower(unit) else highest


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

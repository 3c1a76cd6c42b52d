"""Values as a unit shows them, and their units of measure. Pure."""

from __future__ import annotations

from app.live.state.bus_live import UnitLive, follower, setpoint_decimals
from bus.catalogue import values
from bus.catalogue.numbers import DECIMALS
from bus.catalogue.parameter import Parameter, Scale
from bus.catalogue.values import parameter_unit
from bus.messages import Message, number, term


def setpoint_message(raw: int | None, live: UnitLive) -> str | Message:
    """A setpoint as the unit shows it, marked while its decimals are not known; empty for None."""
    return "" if raw is None else values.speed_message(raw, setpoint_decimals(live))


def parameter_message(parameter: Parameter, raw: int, live: UnitLive) -> Message:
    """A value of a parameter: a choice by its name, a number in this unit's decimals and mode."""
    decimals = live.parameter_raw(DECIMALS)
    return values.parameter_message(parameter, raw, decimals, follower=bool(follower(live)))


def in_measure(value: str | Message, measure: str | Message) -> Message:
    """A number with its measure: ``5.0 s``."""
    shown = number(value) if isinstance(value, str) else value
    return Message.of("value_in_measure", value=shown, measure=measure) if measure else shown


def measure_of_setpoint(unit: UnitLive) -> str:
    """Measure of a setpoint; "" of a ratio, and while the decimals are not known."""
    is_shown = not follower(unit) and setpoint_decimals(unit) is not None
    return unit.settings.labels.unit if is_shown else ""


def measure_of_value(unit: UnitLive, parameter: Parameter, raw: int) -> str | Message:
    """Measure of a value of a parameter; "" of a choice, which has a name, and of a ratio."""
    if raw in parameter.choices:
        return ""
    if parameter.scale is Scale.SPEED or (parameter.scale is Scale.SPEED_OR_RATIO and not follower(unit)):
        return unit.settings.labels.unit
    measure = parameter_unit(parameter)
    return term(measure) if measure else ""

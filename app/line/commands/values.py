"""Values as a unit shows them, and their units of measure. Pure."""

from __future__ import annotations

import re
from decimal import ROUND_HALF_UP, Decimal

from app.line.live.state.bus_live import UnitLive, follower, setpoint_decimals
from bus.catalogue import values
from bus.catalogue.numbers import DECIMALS
from bus.catalogue.parameter import Parameter, Scale
from bus.catalogue.values import parameter_unit
from bus.errors import CallerError
from bus.messages import Message, number, term

_PERCENT = re.compile(r"([+\-\N{MINUS SIGN}]?)([0-9]{1,4}(?:[.,][0-9]{1,3})?)\s*%")


def setpoint_message(raw: int | None, live: UnitLive) -> str | Message:
    """A setpoint as the unit shows it, marked while its decimals are not known; empty for None."""
    return "" if raw is None else values.speed_message(raw, setpoint_decimals(live))


def raw_of_percent(text: str, present: int | None) -> int:
    """``105 %`` or ``+5 %`` of a unit's present raw setpoint, rounded half up. Raises CallerError."""
    found = _PERCENT.fullmatch(text.strip())
    sign, size = (found[1], Decimal(found[2].replace(",", "."))) if found else ("", Decimal(0))
    percent = {"": size, "+": 100 + size}.get(sign, 100 - size)
    if found is None or percent < 0:
        raise CallerError(Message.of("percent_malformed", text=text))
    if present is None:
        raise CallerError(Message("percent_of_unknown"))
    return int((present * percent / 100).quantize(Decimal(1), ROUND_HALF_UP))


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

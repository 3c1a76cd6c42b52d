"""What a value in display units depends on: the parameters of its unit that convert and bound it. Pure.

The keypad of a unit can change them at any time. A command therefore carries those that its value was shown
with to the worker, which reads them from the unit before it writes, and again with the read-back.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from app.errors import Problem
from app.line.commands.rules.setpoint_range import KIND_OF_PARAMETER, SetpointKind, kind_of
from app.line.live.state.bus_live import BusLive, UnitLive
from bus.catalogue.numbers import (
    ANALOG_OUT_HIGH,
    ANALOG_OUT_LOW,
    ANALOG_OUT_SOURCE,
    DECIMALS,
    FOLLOWER_MODE,
    MAX_DISPLAY,
    MAX_RATIO,
    MIN_RATIO,
)
from bus.catalogue.parameter import Scale
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Action, ExecuteSpeed, SetLine, SetSpeed, UnitScale, WriteAnalogOutput, WriteParameter
from bus.messages import Message

Scales = Mapping[int, UnitScale]
"""By unit."""

# The decimals come last: they are then what was read closest to the write, and to the result.
_BOUNDS: dict[SetpointKind, tuple[int, ...]] = {"speed": (MAX_DISPLAY,), "ratio": (MIN_RATIO, MAX_RATIO)}
_CONVERTS: dict[SetpointKind, tuple[int, ...]] = {
    "speed": (FOLLOWER_MODE, DECIMALS),
    "ratio": (FOLLOWER_MODE,),
}
_CONVERTS_PARAMETER = {Scale.SPEED: (DECIMALS,), Scale.SPEED_OR_RATIO: (FOLLOWER_MODE, DECIMALS)}
_ANALOG_OUTPUT = (ANALOG_OUT_SOURCE, ANALOG_OUT_LOW, ANALOG_OUT_HIGH)
_NONE = "-"
"""The text of a value that depends on nothing: an empty field of a form is none."""
_TEXT = re.compile(r"-|(?:\d{1,2}:(?:\d{1,10}|none)(?:,(?!$)|$))+", re.ASCII)


def setpoint_scale(unit: UnitLive, raw: int, kind: SetpointKind | None = None) -> UnitScale:
    """Of a setpoint. Speed 0 has none: it is 0 in each, and nothing may keep a line from being set to it."""
    kind = kind or kind_of(unit)
    if raw == 0 and kind == "speed":
        return {}
    return _known(unit, (*_BOUNDS[kind], *_CONVERTS[kind]))


def parameter_scale(unit: UnitLive, number: int, raw: int) -> UnitScale:
    """Of a value of a parameter."""
    kind = KIND_OF_PARAMETER.get(number)
    if kind is not None:
        return setpoint_scale(unit, raw, kind)
    return _known(unit, _CONVERTS_PARAMETER.get(PARAMETERS[number].scale, ()))


def analog_scale(unit: UnitLive) -> UnitScale:
    """Of a value of the analog output, which is shown in volts too."""
    return _known(unit, _ANALOG_OUTPUT)


def scales_of(action: Action, bus: BusLive) -> Scales:
    """Of the values of a command, as its units were last read."""
    match action:
        case SetSpeed(unit=unit, raw=raw):
            return {unit: setpoint_scale(bus.units[unit], raw)}
        case SetLine(setpoints=setpoints):
            return {unit: setpoint_scale(bus.units[unit], raw) for unit, raw in setpoints.items()}
        case ExecuteSpeed(unit=unit):
            return {unit: setpoint_scale(bus.units[unit], 1)}
        case WriteAnalogOutput(unit=unit):
            return {unit: analog_scale(bus.units[unit])}
        case WriteParameter(unit=unit, number=number, raw=raw) if number in PARAMETERS:
            return {unit: parameter_scale(bus.units[unit], number, raw)}
    return {}


def wording_scales(action: Action, bus: BusLive) -> Scales:
    """What the events need to show the values of a command that was given raw: what converts, and nothing
    that only bounds. The worker reads it after the write, which therefore waits for nothing."""
    needed = {FOLLOWER_MODE, DECIMALS} if not isinstance(action, WriteAnalogOutput) else set[int]()
    return {
        unit: {number: raw for number, raw in scale.items() if number in needed}
        for unit, scale in scales_of(action, bus).items()
    }


def differs(scale: UnitScale, unit: UnitLive) -> bool:
    """Whether a unit, as it was last read, has another scale."""
    known = unit.parameters
    return any(number in known and known[number].raw != raw for number, raw in scale.items())


def scale_text(scale: UnitScale) -> str:
    """As the form of a review holds it: ``2:20000,8:0,3:1``."""
    pairs = [f"{number}:{'none' if raw is None else raw}" for number, raw in scale.items()]
    return ",".join(pairs) or _NONE


def parse_scale(text: object) -> UnitScale:
    """What the form of a review holds. Raises Problem 422 for what none holds."""
    if not isinstance(text, str) or _TEXT.fullmatch(text) is None:
        raise Problem(422, "invalid", Message("not_what_was_reviewed"))
    pairs = (pair.split(":") for pair in text.split(",") if pair != _NONE)
    scale = {int(number): None if raw == "none" else int(raw) for number, raw in pairs}
    if not scale.keys() <= PARAMETERS.keys() or any((raw or 0) > 0xFFFF_FFFF for raw in scale.values()):
        raise Problem(422, "invalid", Message("not_what_was_reviewed"))
    return scale


def _known(unit: UnitLive, numbers: tuple[int, ...]) -> UnitScale:
    return {number: unit.parameters[number].raw for number in numbers if number in unit.parameters}

"""Values as a unit shows them: their text, the scale on which they depend, and their words in the events.
Pure.

The parameters that convert and bound a value are its scale. The keypad of a unit can change them at any time.
A command therefore carries those in which its value was shown to the worker, which reads them from the unit
before it writes, and again with the read-back.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import ROUND_HALF_UP, Decimal
from typing import Any

from app.errors import Problem
from app.line.commands.rules import KIND_OF_PARAMETER, SetpointKind, commanded_setpoint, kind_of
from app.line.live.bus_live import BusLive, UnitLive, follower, setpoint_decimals
from bus.catalogue import values as unit_values
from bus.catalogue.parameters import (
    ANALOG_OUT_HIGH,
    ANALOG_OUT_LOW,
    ANALOG_OUT_SOURCE,
    DECIMALS,
    FOLLOWER_MODE,
    MAX_DISPLAY,
    MAX_RATIO,
    MIN_RATIO,
    PARAMETERS,
    Parameter,
    Scale,
)
from bus.catalogue.values import OUTPUT_NUMBERS, output_is_on, parameter_unit
from bus.contract import (
    Action,
    ExecuteAll,
    ExecuteSpeed,
    SetLine,
    SetSpeed,
    UnitScale,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.errors import CallerError
from bus.messages import Message, listed, number, term

_PERCENT = re.compile(r"([+\-\N{MINUS SIGN}]?)([0-9]{1,4}(?:[.,][0-9]{1,3})?)\s*%")


def setpoint_message(raw: int | None, live: UnitLive) -> str | Message:
    """Return a setpoint as the unit shows it, marked while its decimals are not known; empty for None."""
    return "" if raw is None else unit_values.speed_message(raw, setpoint_decimals(live))


def raw_of_percent(text: str, present: int | None) -> int:
    """Convert ``105 %`` or ``+5 %`` of a unit's present raw setpoint, rounded half up. Raise CallerError."""
    found = _PERCENT.fullmatch(text.strip())
    sign, size = (found[1], Decimal(found[2].replace(",", "."))) if found else ("", Decimal(0))
    percent = {"": size, "+": 100 + size}.get(sign, 100 - size)
    if found is None or percent < 0:
        raise CallerError(Message.of("percent_malformed", text=text))
    if present is None:
        raise CallerError(Message("percent_of_unknown"))
    return int((present * percent / 100).quantize(Decimal(1), ROUND_HALF_UP))


def parameter_message(parameter: Parameter, raw: int, live: UnitLive) -> Message:
    """Return a value of a parameter: a choice by its name, a number in this unit's decimals and mode."""
    decimals = live.parameter_raw(DECIMALS)
    return unit_values.parameter_message(parameter, raw, decimals, follower=bool(follower(live)))


def in_measure(value: str | Message, measure: str | Message) -> Message:
    """Return a number with its measure: ``5.0 s``."""
    shown = number(value) if isinstance(value, str) else value
    return Message.of("value_in_measure", value=shown, measure=measure) if measure else shown


def measure_of_setpoint(unit: UnitLive) -> str:
    """Return the measure of a setpoint; "" for a ratio, and while the decimals are not known."""
    is_shown = not follower(unit) and setpoint_decimals(unit) is not None
    return unit.settings.labels.unit if is_shown else ""


def measure_of_value(unit: UnitLive, parameter: Parameter, raw: int) -> str | Message:
    """Return the measure of a value of a parameter; "" for a choice, which has a name, and for a ratio."""
    if raw in parameter.choices:
        return ""
    if parameter.scale is Scale.SPEED or (parameter.scale is Scale.SPEED_OR_RATIO and not follower(unit)):
        return unit.settings.labels.unit
    measure = parameter_unit(parameter)
    return term(measure) if measure else ""


Scales = Mapping[int, UnitScale]
"""The scale of each unit's value, by unit."""

# The decimals come last, so that they are read closest to the write, and to the result.
_BOUNDS: dict[SetpointKind, tuple[int, ...]] = {"speed": (MAX_DISPLAY,), "ratio": (MIN_RATIO, MAX_RATIO)}
_CONVERTS: dict[SetpointKind, tuple[int, ...]] = {
    "speed": (FOLLOWER_MODE, DECIMALS),
    "ratio": (FOLLOWER_MODE,),
}
_CONVERTS_PARAMETER = {Scale.SPEED: (DECIMALS,), Scale.SPEED_OR_RATIO: (FOLLOWER_MODE, DECIMALS)}
_ANALOG_OUTPUT = (ANALOG_OUT_SOURCE, ANALOG_OUT_LOW, ANALOG_OUT_HIGH)
_NONE = "-"
"""The text of an empty scale, because an empty field of a form counts as missing."""
_TEXT = re.compile(r"-|(?:\d{1,2}:(?:\d{1,10}|none)(?:,(?!$)|$))+", re.ASCII)


def setpoint_scale(unit: UnitLive, raw: int, kind: SetpointKind | None = None) -> UnitScale:
    """Return the scale of a setpoint. Speed 0 has none: it is 0 in each, and is always sent."""
    kind = kind or kind_of(unit)
    if raw == 0 and kind == "speed":
        return {}
    return _known(unit, (*_BOUNDS[kind], *_CONVERTS[kind]))


def parameter_scale(unit: UnitLive, number: int, raw: int) -> UnitScale:
    """Return the scale of a value of a parameter."""
    kind = KIND_OF_PARAMETER.get(number)
    if kind is not None:
        return setpoint_scale(unit, raw, kind)
    return _known(unit, _CONVERTS_PARAMETER.get(PARAMETERS[number].scale, ()))


def analog_scale(unit: UnitLive) -> UnitScale:
    """Return the scale of the analog output, which is shown in volts too."""
    return _known(unit, _ANALOG_OUTPUT)


def scales_of(action: Action, bus: BusLive) -> Scales:
    """Return the scale of each unit's value in a command, as the units were last read."""
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
    """Return the parameters that the events need to show the values of a command that was given raw: those
    that convert, not those that only bound. The worker reads them after the write, which waits for
    nothing."""
    needed = {FOLLOWER_MODE, DECIMALS} if not isinstance(action, WriteAnalogOutput) else set[int]()
    return {
        unit: {number: raw for number, raw in scale.items() if number in needed}
        for unit, scale in scales_of(action, bus).items()
    }


def differs(scale: UnitScale, unit: UnitLive) -> bool:
    """Return whether a unit was last read to have another scale."""
    known = unit.parameters
    return any(number in known and known[number].raw != raw for number, raw in scale.items())


def scale_text(scale: UnitScale) -> str:
    """Return a scale as the form of a review holds it: ``2:20000,8:0,3:1``."""
    pairs = [f"{number}:{'none' if raw is None else raw}" for number, raw in scale.items()]
    return ",".join(pairs) or _NONE


def parse_scale(text: object) -> UnitScale:
    """Parse the scale in the form of a review. Raise Problem 422 for any text that :func:`scale_text` does
    not write."""
    if not isinstance(text, str) or _TEXT.fullmatch(text) is None:
        raise Problem(422, "invalid", Message("not_what_was_reviewed"))
    pairs = (pair.split(":") for pair in text.split(",") if pair != _NONE)
    scale = {int(number): None if raw == "none" else int(raw) for number, raw in pairs}
    if not scale.keys() <= PARAMETERS.keys() or any((raw or 0) > 0xFFFF_FFFF for raw in scale.values()):
        raise Problem(422, "invalid", Message("not_what_was_reviewed"))
    return scale


def _known(unit: UnitLive, numbers: tuple[int, ...]) -> UnitScale:
    return {number: unit.parameters[number].raw for number in numbers if number in unit.parameters}


_ON_OFF = (term("off"), term("on"))


@dataclass(frozen=True, slots=True)
class Wording:
    """The words of a command in the events: its name, its old value as last read, its new value. Texts are
    empty and integers None if there is no single value."""

    what: Message
    old: str | Message = ""
    new: str | Message = ""
    old_raw: int | None = None
    new_raw: int | None = None


def output_wording(action: WriteOutput, bus: BusLive) -> Wording:
    """Describe 87h in words."""
    reading = bus.units[action.unit].reading
    was: bool | None = None
    if reading is not None and action.number in OUTPUT_NUMBERS:
        was = output_is_on(reading.outputs, action.number)
    old: str | Message = "" if was is None else _ON_OFF[was]
    return Wording(
        Message.of("event_set_output", number=action.number),
        old,
        _ON_OFF[action.on],
        None if was is None else int(was),
        int(action.on),
    )


def parameter_wording(action: WriteParameter, bus: BusLive) -> Wording:
    """Describe 86h in words, without the value of a secret."""
    parameter, live = PARAMETERS.get(action.number), bus.units[action.unit]
    if parameter is None:
        return Wording(Message.of("event_write_unknown_parameter", number=action.number), new_raw=action.raw)
    what = Message.of("event_write_parameter", number=parameter.number, called=parameter.name)
    new = parameter_message(parameter, action.raw, live)
    if parameter.secret:
        return Wording(what, new, new)
    raw = live.parameter_raw(parameter.number)
    old = "" if raw is None else parameter_message(parameter, raw, live)
    return Wording(what, old, new, raw, action.raw)


def setpoint_wording(what: Message, bus: BusLive, unit: int, raw: int | None) -> Wording:
    """Return words for a new setpoint of a unit; ``raw`` None if it is not known."""
    live = bus.units[unit]
    old = commanded_setpoint(live, bus)
    return Wording(what, setpoint_message(old, live), setpoint_message(raw, live), old, raw)


def staging_wording(bus: BusLive, unit: int, raw: int) -> Wording:
    """Return words for a setpoint that is staged: in place of another one it discards that, if the unit is
    commanded so already."""
    live = bus.units[unit]
    if live.staged is None or raw != commanded_setpoint(live, bus):
        return setpoint_wording(Message("event_stage_speed"), bus, unit, raw)
    old, new = setpoint_message(live.staged, live), setpoint_message(raw, live)
    return Wording(Message("event_discard_staged"), old, new, live.staged, raw)


def reworded(
    action: Action, words: Wording, parts: Mapping[int, Wording], bus: BusLive
) -> tuple[dict[str, Message], dict[int, dict[str, Message]]]:
    """Return the old and new values of a command, and of its parts by unit, that differ from their wording
    now that the scale was read with the command."""
    by_unit = {unit: _in_scale(action, part, bus.units[unit]) for unit, part in parts.items()}
    changed = {unit: texts for unit, part in parts.items() if (texts := _other(part, by_unit[unit]))}
    if action.only_unit is not None:
        return _other(words, _in_scale(action, words, bus.units[action.only_unit])), {}
    if not changed:
        return {}, {}
    olds, news = ({unit: getattr(part, end) for unit, part in by_unit.items()} for end in ("old", "new"))
    return {"old": _by_unit(olds), "new": _by_unit(news)}, changed


def _in_scale(action: Action, words: Wording, live: UnitLive) -> Wording:
    """Return ``words`` with its integers as the unit shows them now."""
    match action:
        case SetSpeed() | SetLine() | ExecuteSpeed() | ExecuteAll():
            old, new = setpoint_message(words.old_raw, live), setpoint_message(words.new_raw, live)
        case WriteParameter(number=number) if number in PARAMETERS and not PARAMETERS[number].secret:
            old, new = (
                "" if raw is None else parameter_message(PARAMETERS[number], raw, live)
                for raw in (words.old_raw, words.new_raw)
            )
        case _:
            return words
    return replace(words, old=old, new=new)


def _other(words: Wording, now: Wording) -> dict[str, Message]:
    texts = {"old": (words.old, now.old), "new": (words.new, now.new)}
    return {name: text for name, (was, text) in texts.items() if isinstance(text, Message) and text != was}


_SPEEDS = {
    "outsider_staged": ("staged",),
    "speed_moved": ("before", "value"),
    "speed_reads": ("value",),
    "speed_reads_while": ("value",),
    "staged_left": ("raw",),
    "staged_withdrawn": ("present",),
    "unit_may_hold": ("raw",),
}
"""The params that are raw speeds in the worker's messages, by code."""


def with_names(message: Message, bus: BusLive, unit: int | None = None) -> Message:
    """Return a message of the worker as people read it: units by their names, speeds as their units show
    them. ``unit``: the one that the message is about."""
    units, own = bus.units, message.params.get("unit")
    unit = own if isinstance(own, int) else unit

    def in_words(name: str, value: Any) -> Any:
        match value:
            case Message():
                return with_names(value, bus, unit)
            case list():
                return [in_words(name, each) for each in value]
            case int() if name in ("unit", "units") and value in units:
                return units[value].settings.name
            case int() if unit in units and name in _SPEEDS.get(message.code, ()):
                return in_measure(setpoint_message(value, units[unit]), measure_of_setpoint(units[unit]))
        return value

    params = {name: in_words(name, value) for name, value in message.params.items()}
    return Message.of(message.code, **params)


def wordings_by_unit(what: Message, bus: BusLive, setpoints: Mapping[int, int]) -> dict[int, Wording]:
    """Return words for the part of each unit in a change of several."""
    return {unit: setpoint_wording(what, bus, unit, setpoints[unit]) for unit in sorted(setpoints)}


def line_wording(what: Message, bus: BusLive, setpoints: Mapping[int, int]) -> Wording:
    """Return words for the new setpoints of several units."""
    units = wordings_by_unit(what, bus, setpoints)
    return Wording(
        what,
        _by_unit({unit: words.old for unit, words in units.items()}),
        _by_unit({unit: words.new for unit, words in units.items()}),
    )


def _by_unit(values: dict[int, str | Message]) -> Message:
    return listed(
        [
            Message.of("value_of_unit", unit=unit, value=value or term("unknown"))
            for unit, value in values.items()
        ]
    )

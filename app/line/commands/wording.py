"""What a command is called in the events, with its old value as it was last read and its new one. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from app.line.commands.rules.setpoint import commanded_setpoint
from app.line.commands.values import parameter_message, setpoint_message
from app.line.live.state.bus_live import BusLive, UnitLive
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import OUTPUT_NUMBERS, output_is_on
from bus.contract import (
    Action,
    ExecuteAll,
    ExecuteSpeed,
    SetLine,
    SetSpeed,
    WriteOutput,
    WriteParameter,
)
from bus.messages import Message, listed, term

_ON_OFF = (term("off"), term("on"))


@dataclass(frozen=True, slots=True)
class Wording:
    """One command for the events. Texts are empty and integers None where there is no one value."""

    what: Message
    old: str | Message = ""
    new: str | Message = ""
    old_raw: int | None = None
    new_raw: int | None = None


def of_write_output(action: WriteOutput, bus: BusLive) -> Wording:
    """87h."""
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


def of_write_parameter(action: WriteParameter, bus: BusLive) -> Wording:
    """86h. Of a secret no value."""
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


def of_setpoint(what: Message, bus: BusLive, unit: int, raw: int | None) -> Wording:
    """A new setpoint of a unit; ``raw`` None where it is not known."""
    live = bus.units[unit]
    old = commanded_setpoint(live, bus)
    return Wording(what, setpoint_message(old, live), setpoint_message(raw, live), old, raw)


def reworded(
    action: Action, words: Wording, parts: Mapping[int, Wording], bus: BusLive
) -> tuple[dict[str, Message], dict[int, dict[str, Message]]]:
    """The old and new values of a command, and of its parts by unit, that its units show otherwise than they
    were worded, as the scale was read with the command."""
    by_unit = {unit: _in_scale(action, part, bus.units[unit]) for unit, part in parts.items()}
    changed = {unit: texts for unit, part in parts.items() if (texts := _other(part, by_unit[unit]))}
    if action.only_unit is not None:
        return _other(words, _in_scale(action, words, bus.units[action.only_unit])), {}
    if not changed:
        return {}, {}
    olds, news = ({unit: getattr(part, end) for unit, part in by_unit.items()} for end in ("old", "new"))
    return {"old": _by_unit(olds), "new": _by_unit(news)}, changed


def _in_scale(action: Action, words: Wording, live: UnitLive) -> Wording:
    """``words`` with its integers as the unit shows them now."""
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


def of_each(what: Message, bus: BusLive, setpoints: Mapping[int, int]) -> dict[int, Wording]:
    """What a change of several means for each unit."""
    return {unit: of_setpoint(what, bus, unit, setpoints[unit]) for unit in sorted(setpoints)}


def of_several(what: Message, bus: BusLive, setpoints: Mapping[int, int]) -> Wording:
    """The new setpoints of several units."""
    units = of_each(what, bus, setpoints)
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

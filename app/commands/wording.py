"""What a command is called in the events, with its old value as it was last read and its new one. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from app.commands.rules.setpoint import commanded_setpoint, staged_setpoints
from app.commands.values import parameter_message, setpoint_message
from app.live.state.bus_live import BusLive
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import OUTPUT_NUMBERS, output_is_on
from bus.contract import ExecuteAll, ExecuteSpeed, SetLine, SetSpeed, WriteOutput, WriteParameter
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


def of_set_speed(action: SetSpeed, bus: BusLive) -> Wording:
    """84h or 82h."""
    what = Message("event_set_speed") if action.execute else Message("event_stage_speed")
    return _of_setpoint(what, bus, action.unit, action.raw)


def of_execute_speed(action: ExecuteSpeed, bus: BusLive) -> Wording:
    """83h to one unit."""
    return _of_setpoint(Message("event_execute_speed"), bus, action.unit, bus.units[action.unit].staged)


def of_set_line(action: SetLine, bus: BusLive) -> Wording:
    """82h to each unit, 83h to all."""
    return _of_line(Message.of("event_set_line", n=len(action.setpoints)), action.setpoints, bus)


def of_execute_all(_: ExecuteAll, bus: BusLive) -> Wording:
    """83h to all units."""
    return _of_line(Message("event_execute_all"), staged_setpoints(bus), bus)


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


def parts_of_set_line(action: SetLine, bus: BusLive) -> dict[int, Wording]:
    """What the change means for each unit."""
    what = Message.of("event_set_speed_of_several", n=len(action.setpoints))
    return _of_parts(what, action.setpoints, bus)


def parts_of_execute_all(_: ExecuteAll, bus: BusLive) -> dict[int, Wording]:
    """What the broadcast means for each unit that is known to hold a staged speed."""
    return _of_parts(Message("event_execute_with_all"), staged_setpoints(bus), bus)


def _of_parts(what: Message, setpoints: Mapping[int, int], bus: BusLive) -> dict[int, Wording]:
    return {unit: _of_setpoint(what, bus, unit, setpoints[unit]) for unit in sorted(setpoints)}


def _of_setpoint(what: Message, bus: BusLive, unit: int, raw: int | None) -> Wording:
    live = bus.units[unit]
    old = commanded_setpoint(live, bus)
    return Wording(what, setpoint_message(old, live), setpoint_message(raw, live), old, raw)


def _of_line(what: Message, setpoints: Mapping[int, int], bus: BusLive) -> Wording:
    units = {unit: bus.units[unit] for unit in sorted(setpoints)}
    old = {unit: setpoint_message(commanded_setpoint(live, bus), live) for unit, live in units.items()}
    new = {unit: setpoint_message(setpoints[unit], live) for unit, live in units.items()}
    return Wording(what, _by_unit(old), _by_unit(new))


def _by_unit(values: dict[int, str | Message]) -> Message:
    return listed(
        [
            Message.of("value_of_unit", unit=unit, value=value or term("unknown"))
            for unit, value in values.items()
        ]
    )

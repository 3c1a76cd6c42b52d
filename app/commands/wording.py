"""What a command is called in the events, with its old value as it was last read and its new one. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from app.commands.rules.new_setpoints import staged_setpoints
from app.commands.rules.setpoint import commanded_setpoint
from app.commands.values import known_parameter_text, shown_setpoint, text_of
from app.live.state.bus_live import BusLive
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import OUTPUT_NUMBERS, output_is_on
from bus.contract import ExecuteAll, ExecuteSpeed, SetLine, SetSpeed, WriteOutput, WriteParameter

_ON_OFF = ("off", "on")


@dataclass(frozen=True, slots=True)
class Wording:
    """One command for the events. Texts are empty and integers None where there is no one value."""

    what: str
    old: str = ""
    new: str = ""
    old_raw: int | None = None
    new_raw: int | None = None


def of_set_speed(action: SetSpeed, bus: BusLive) -> Wording:
    """84h or 82h."""
    what = "set speed (84h)" if action.execute else "stage speed (82h)"
    return _of_setpoint(what, bus, action.unit, action.raw)


def of_execute_speed(action: ExecuteSpeed, bus: BusLive) -> Wording:
    """83h to one unit."""
    return _of_setpoint("execute staged speed (83h)", bus, action.unit, bus.units[action.unit].staged)


def of_set_line(action: SetLine, bus: BusLive) -> Wording:
    """82h to each unit, 83h to all."""
    count = len(action.setpoints)
    what = "set 1 unit (82h, 83h)" if count == 1 else f"set {count} units at once (82h, 83h)"
    return _of_line(what, action.setpoints, bus)


def of_execute_all(_: ExecuteAll, bus: BusLive) -> Wording:
    """83h to all units."""
    return _of_line("execute every staged speed (83h to all)", staged_setpoints(bus), bus)


def of_write_output(action: WriteOutput, bus: BusLive) -> Wording:
    """87h."""
    reading = bus.units[action.unit].reading
    was: bool | None = None
    if reading is not None and action.number in OUTPUT_NUMBERS:
        was = output_is_on(reading.outputs, action.number)
    old = "" if was is None else _ON_OFF[was]
    return Wording(
        f"set output {action.number} (87h)",
        old,
        _ON_OFF[action.on],
        None if was is None else int(was),
        int(action.on),
    )


def of_write_parameter(action: WriteParameter, bus: BusLive) -> Wording:
    """86h. Of a secret no value."""
    parameter, live = PARAMETERS.get(action.number), bus.units[action.unit]
    if parameter is None:
        return Wording(f"write #{action.number} (86h)", new_raw=action.raw)
    what = f"write #{parameter.number} {parameter.name} (86h)"
    new = text_of(parameter, action.raw, live)
    if parameter.secret:
        return Wording(what, new, new)
    old = known_parameter_text(parameter, live)
    return Wording(what, old, new, live.parameter_raw(parameter.number), action.raw)


def parts_of_set_line(action: SetLine, bus: BusLive) -> dict[int, Wording]:
    """What the change means for each unit."""
    what = f"set speed, one of {len(action.setpoints)} at once (82h, 83h)"
    return _of_parts(what, action.setpoints, bus)


def parts_of_execute_all(_: ExecuteAll, bus: BusLive) -> dict[int, Wording]:
    """What the broadcast means for each unit that is known to hold a staged speed."""
    return _of_parts("execute staged speed, with every unit (83h to all)", staged_setpoints(bus), bus)


def _of_parts(what: str, setpoints: Mapping[int, int], bus: BusLive) -> dict[int, Wording]:
    return {unit: _of_setpoint(what, bus, unit, setpoints[unit]) for unit in sorted(setpoints)}


def _of_setpoint(what: str, bus: BusLive, unit: int, raw: int | None) -> Wording:
    live = bus.units[unit]
    old = commanded_setpoint(live, bus)
    return Wording(what, shown_setpoint(old, live), shown_setpoint(raw, live), old, raw)


def _of_line(what: str, setpoints: Mapping[int, int], bus: BusLive) -> Wording:
    units = {unit: bus.units[unit] for unit in sorted(setpoints)}
    old = {unit: shown_setpoint(commanded_setpoint(live, bus), live) for unit, live in units.items()}
    new = {unit: shown_setpoint(setpoints[unit], live) for unit, live in units.items()}
    return Wording(what, _by_unit(old), _by_unit(new))


def _by_unit(texts: dict[int, str]) -> str:
    return ", ".join(f"{unit}: {text or 'unknown'}" for unit, text in texts.items())

"""What an action is called, and its old and new value, as people read them in the events. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from app.commands.rules import setpoints_of
from app.commands.setpoints import commanded_setpoint
from app.live.state import BusLive, UnitLive, follower
from app.live.view import setpoint_text
from bus.catalogue.numbers import DECIMALS
from bus.catalogue.parameter import Parameter
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import OUTPUT_NUMBERS, output_is_on
from bus.catalogue.values import parameter_text
from bus.contract import (
    Action,
    ChangeBaud,
    ExecuteAll,
    ExecuteSpeed,
    ReadParameters,
    ReadTrace,
    ScanBus,
    SetLine,
    SetSpeed,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)

_ON_OFF = ("off", "on")


@dataclass(frozen=True, slots=True)
class Wording:
    """One command for the events. Texts are empty and integers None where there is no one value."""

    what: str
    old: str = ""
    new: str = ""
    old_raw: int | None = None
    new_raw: int | None = None


def wording(action: Action, bus: BusLive) -> Wording:
    """``action`` in words, with the old value as it was last read."""
    match action:
        case SetSpeed():
            return _speed(action, bus)
        case ExecuteSpeed():
            return _setpoint("execute staged speed (83h)", bus, action.unit, bus.units[action.unit].staged)
        case SetLine():
            count = len(action.setpoints)
            what = "set 1 unit (82h, 83h)" if count == 1 else f"set {count} units at once (82h, 83h)"
            return _line(what, action, bus)
        case ExecuteAll():
            return _line("execute every staged speed (83h to all)", action, bus)
        case WriteOutput():
            return _output(action, bus)
        case WriteAnalogOutput():
            return Wording("set analog output (88h)", new=str(action.raw), new_raw=action.raw)
        case WriteParameter():
            return _parameter(action, bus.units[action.unit])
        case _:
            return _without_values(action, bus)


def wordings_by_unit(action: Action, bus: BusLive) -> dict[int, Wording]:
    """What a change of several means for each of its units; empty for any other action."""
    match action:
        case SetLine():
            what = f"set speed, one of {len(action.setpoints)} at once (82h, 83h)"
        case ExecuteAll():
            what = "execute staged speed, with every unit (83h to all)"
        case _:
            return {}
    setpoints = setpoints_of(action, bus)
    return {unit: _setpoint(what, bus, unit, setpoints[unit]) for unit in sorted(setpoints)}


def shown_setpoint(raw: int | None, live: UnitLive) -> str:
    """A setpoint as the unit shows it; the bare integer, marked, while its decimals are not known."""
    return "" if raw is None else setpoint_text(live, raw) or f"{raw} raw"


def known_parameter_text(parameter: Parameter, live: UnitLive) -> str:
    """A parameter as last read, as people read it; empty when it never was."""
    raw = live.parameter_raw(parameter.number)
    return "" if raw is None else text_of(parameter, raw, live)


def text_of(parameter: Parameter, raw: int, live: UnitLive) -> str:
    """A value of a parameter in this unit's decimals and mode."""
    return parameter_text(parameter, raw, live.parameter_raw(DECIMALS), follower=bool(follower(live)))


def _speed(action: SetSpeed, bus: BusLive) -> Wording:
    what = "set speed (84h)" if action.execute else "stage speed (82h)"
    return _setpoint(what, bus, action.unit, action.raw)


def _setpoint(what: str, bus: BusLive, unit: int, raw: int | None) -> Wording:
    live = bus.units[unit]
    old = commanded_setpoint(live, bus)
    return Wording(what, shown_setpoint(old, live), shown_setpoint(raw, live), old, raw)


def _line(what: str, action: Action, bus: BusLive) -> Wording:
    setpoints = setpoints_of(action, bus)
    units = {unit: bus.units[unit] for unit in sorted(setpoints)}
    old = {unit: shown_setpoint(commanded_setpoint(live, bus), live) for unit, live in units.items()}
    new = {unit: shown_setpoint(setpoints[unit], live) for unit, live in units.items()}
    return Wording(what, _by_unit(old), _by_unit(new))


def _by_unit(texts: dict[int, str]) -> str:
    return ", ".join(f"{unit}: {text or 'unknown'}" for unit, text in texts.items())


def _output(action: WriteOutput, bus: BusLive) -> Wording:
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


def _parameter(action: WriteParameter, live: UnitLive) -> Wording:
    parameter = PARAMETERS.get(action.number)
    if parameter is None:
        return Wording(f"write #{action.number} (86h)", new_raw=action.raw)
    what = f"write #{parameter.number} {parameter.name} (86h)"
    new = text_of(parameter, action.raw, live)
    if parameter.secret:
        return Wording(what, new, new)
    old = known_parameter_text(parameter, live)
    return Wording(what, old, new, live.parameter_raw(parameter.number), action.raw)


def _without_values(action: Action, bus: BusLive) -> Wording:
    match action:
        case ChangeBaud():
            return Wording("change the baud of the line", str(bus.baud), str(action.baud))
        case ScanBus():
            return Wording(f"scan the addresses {action.first} to {action.last}")
        case ReadParameters():
            return Wording(f"read {len(action.numbers) or len(PARAMETERS)} parameters (85h)")
        case ReadTrace():
            return Wording("read the kept frames")
    raise AssertionError(action)

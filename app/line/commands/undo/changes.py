"""The values that a command changes, what they are now, and the command that sets them again. Pure.

The setpoint of a unit, an output, the analog output and a parameter are each one place. The analog output
cannot be read; what it is now is passed in.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

from app.line.commands.review import present_setpoint
from app.line.live.bus_live import BusLive
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import output_is_on
from bus.contract import (
    Action,
    ExecuteSpeed,
    SetLine,
    SetSpeed,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)

PlaceKind = Literal["setpoint", "output", "analog", "parameter"]


class ValuePlace(NamedTuple):
    """``number``: of the output or parameter; 0 of a setpoint and of the analog output."""

    kind: PlaceKind
    unit: int
    number: int = 0


Values = Mapping[ValuePlace, int]
"""Raw; an output is 0 or 1."""


def values_set(action: Action, bus: BusLive) -> Values | None:
    """What the command sets. A unit outside a change of several keeps its speed and what it holds staged
    (``bus/line/commands/staging.py``). None for a command that changes more, or something else."""
    match action:
        case SetSpeed(unit=unit, raw=raw, execute=True):
            return {ValuePlace("setpoint", unit): raw}
        case ExecuteSpeed(unit=unit):
            staged = bus.units[unit].staged
            return None if staged is None else {ValuePlace("setpoint", unit): staged}
        case SetLine(setpoints=setpoints):
            return {ValuePlace("setpoint", unit): raw for unit, raw in setpoints.items()}
        case WriteOutput(unit=unit, number=number, on=on):
            return {ValuePlace("output", unit, number): int(on)}
        case WriteAnalogOutput(unit=unit, raw=raw):
            return {ValuePlace("analog", unit): raw}
        case WriteParameter(unit=unit, number=number, raw=raw) if not PARAMETERS[number].secret:
            return {ValuePlace("parameter", unit, number): raw}
    return None


def value_now(place: ValuePlace, bus: BusLive, analog: Mapping[int, int]) -> int | None:
    """The value as last read; None while it is not known. ``analog``: what each unit has acknowledged."""
    unit = bus.units[place.unit]
    match place.kind:
        case "setpoint":
            return present_setpoint(bus, unit)
        case "output":
            return None if unit.reading is None else int(output_is_on(unit.reading.outputs, place.number))
        case "analog":
            return analog.get(place.unit)
        case "parameter":
            return unit.parameter_raw(place.number)


def action_for(values: Values) -> Action:
    """The command that sets these values: several setpoints, or one of anything."""
    if len(values) > 1:
        return SetLine(setpoints={place.unit: raw for place, raw in values.items()})
    ((place, raw),) = values.items()
    match place.kind:
        case "setpoint":
            return SetSpeed(unit=place.unit, raw=raw)
        case "output":
            return WriteOutput(unit=place.unit, number=place.number, on=bool(raw))
        case "analog":
            return WriteAnalogOutput(unit=place.unit, raw=raw)
        case "parameter":
            return WriteParameter(unit=place.unit, number=place.number, raw=raw)


def is_undo(action: Action, before: Values) -> bool:
    """Whether a command sets these values again. A change of several units may leave some of them out."""
    if not isinstance(action, SetLine):
        return action == action_for(before)
    back = {ValuePlace("setpoint", unit): raw for unit, raw in action.setpoints.items()}
    return bool(back) and back.items() <= before.items()

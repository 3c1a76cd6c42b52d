"""The setpoints that a command would bring about. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from app.commands.rules.setpoint_range import KIND_OF_PARAMETER, SetpointKind
from app.live.state.bus_live import BusLive
from bus.contract import ExecuteAll, ExecuteSpeed, SetLine, SetSpeed, WriteParameter


@dataclass(frozen=True, slots=True)
class NewSetpoint:
    """``kind`` None: the unit's own. ``is_staged``: it changes nothing before it is executed."""

    unit: int
    raw: int
    kind: SetpointKind | None = None
    is_staged: bool = False


def staged_setpoints(bus: BusLive) -> dict[int, int]:
    """What each unit holds staged, raw, by unit."""
    return {number: unit.staged for number, unit in bus.units.items() if unit.staged is not None}


def of_set_speed(action: SetSpeed, _: BusLive) -> list[NewSetpoint]:
    return [NewSetpoint(action.unit, action.raw, is_staged=not action.execute)]


def of_set_line(action: SetLine, _: BusLive) -> list[NewSetpoint]:
    return _by_unit(action.setpoints)


def of_execute_speed(action: ExecuteSpeed, bus: BusLive) -> list[NewSetpoint]:
    """What the unit is known to hold staged."""
    return [each for each in _by_unit(staged_setpoints(bus)) if each.unit == action.unit]


def of_execute_all(_: ExecuteAll, bus: BusLive) -> list[NewSetpoint]:
    """What all units are known to hold staged."""
    return _by_unit(staged_setpoints(bus))


def of_write_parameter(action: WriteParameter, _: BusLive) -> list[NewSetpoint]:
    """The value, where a unit keeps a setpoint in this parameter."""
    kind = KIND_OF_PARAMETER.get(action.number)
    return [] if kind is None else [NewSetpoint(action.unit, action.raw, kind)]


def _by_unit(setpoints: dict[int, int]) -> list[NewSetpoint]:
    return [NewSetpoint(unit, raw) for unit, raw in sorted(setpoints.items())]

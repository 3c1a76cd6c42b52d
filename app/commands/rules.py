"""Whether a wish may be sent: every check that can be made before a byte reaches the wire. Pure.

The unit decides what only it can know: a write in LOCAL and an analog output that is not set for the
link are sent, and refused by the unit in its own words.
"""

from __future__ import annotations

from app.commands.limits import HIGHEST_SETPOINT
from app.commands.objection import Circumstances, ObjectionError
from app.commands.setpoint_range import KIND_OF_PARAMETER, SetpointKind, kind_of
from app.commands.setpoints import check_setpoint
from app.live.state import BusLive, UnitLive
from bus.catalogue.numbers import ANALOG_OUT_HIGH, ANALOG_OUT_LOW
from bus.catalogue.parameter import IllegalValue, Parameter, check_writable_value, danger_of_writing
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import OUTPUT_NUMBERS, status_bits
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
from bus.errors import CallerError
from bus.settings import BAUDS


def check(action: Action, now: Circumstances) -> None:
    """Raises ObjectionError for the first reason not to send ``action``."""
    for unit in units_written(action, now.bus):
        _check_not_blocked(unit, now)
    match action:
        case SetSpeed() | SetLine() | ExecuteSpeed() | ExecuteAll():
            _check_setpoints(action, now)
        case WriteOutput():
            _check_output(action)
        case WriteAnalogOutput():
            _check_analog_output(action, now)
        case WriteParameter():
            _check_parameter(action, now)
        case ChangeBaud():
            _check_baud(action, now)


def is_write(action: Action) -> bool:
    """Whether this can change anything at a unit."""
    return not isinstance(action, ReadParameters | ScanBus | ReadTrace)


def units_named(action: Action) -> list[int]:
    """The units that the action itself names."""
    match action:
        case SetLine():
            return sorted(action.setpoints)
        case ExecuteAll() | ChangeBaud() | ScanBus() | ReadTrace():
            return []
    return [action.unit]


def units_written(action: Action, bus: BusLive) -> list[int]:
    """The units at which this action, or its broadcast, can change something."""
    match action:
        case SetLine():
            return sorted({*action.setpoints, *_staged(bus)})
        case ExecuteAll():
            return list(_staged(bus))
        case ChangeBaud():
            return list(bus.units)
        case SetSpeed() | ExecuteSpeed() | WriteOutput() | WriteAnalogOutput() | WriteParameter():
            return [action.unit]
    return []


def setpoints_of(action: Action, bus: BusLive) -> dict[int, int]:
    """Unit → raw setpoint that this action would bring about, as far as it is known."""
    staged = _staged(bus)
    match action:
        case SetSpeed():
            return {action.unit: action.raw}
        case SetLine():
            return action.setpoints
        case ExecuteSpeed():
            return {action.unit: staged[action.unit]} if action.unit in staged else {}
        case ExecuteAll():
            return staged
        case WriteParameter() if KIND_OF_PARAMETER.get(action.number) == kind_of(bus.units[action.unit]):
            return {action.unit: action.raw}
    return {}


def setpoints_judged(action: Action, bus: BusLive) -> list[tuple[int, int, SetpointKind | None]]:
    """(unit, raw, kind) of each setpoint whose range decides; ``kind`` None: the unit's own."""
    if isinstance(action, WriteParameter) and action.number in KIND_OF_PARAMETER:
        return [(action.unit, action.raw, KIND_OF_PARAMETER[action.number])]
    return [(unit, raw, None) for unit, raw in sorted(setpoints_of(action, bus).items())]


def _staged(bus: BusLive) -> dict[int, int]:
    return {number: unit.staged for number, unit in bus.units.items() if unit.staged is not None}


def _check_not_blocked(unit: int, now: Circumstances) -> None:
    block = now.block(unit)
    if block is not None:
        raise ObjectionError(
            "blocked",
            "unit {unit} is blocked by {who}: {reason}",
            unit=unit,
            params={"unit": unit, "who": block.set_by, "reason": block.reason},
        )


def _check_setpoints(action: Action, now: Circumstances) -> None:
    if isinstance(action, SetLine) and not action.setpoints:
        raise ObjectionError("invalid", "no setpoint is given: name at least one unit")
    for unit, raw, kind in setpoints_judged(action, now.bus):
        check_setpoint(unit, raw, now, kind)


def _check_output(action: WriteOutput) -> None:
    if action.number not in OUTPUT_NUMBERS:
        raise ObjectionError("invalid", "a unit has the auxiliary outputs 1 to 6", unit=action.unit)


def _check_analog_output(action: WriteAnalogOutput, now: Circumstances) -> None:
    live = now.bus.units[action.unit]
    low, high = live.parameter_raw(ANALOG_OUT_LOW), live.parameter_raw(ANALOG_OUT_HIGH)
    lowest = 0 if low is None else low
    highest = HIGHEST_SETPOINT if high is None else max(lowest, high)
    if lowest <= action.raw <= highest:
        return
    nearest = min(max(action.raw, lowest), highest)
    raise ObjectionError(
        "invalid",
        f"unit {action.unit}: the analog output takes {lowest} (0 V, #29) to {highest} (10 V, #30); "
        f"the nearest is {nearest}",
        unit=action.unit,
        nearest=nearest,
    )


def _check_parameter(action: WriteParameter, now: Circumstances) -> None:
    parameter = PARAMETERS.get(action.number)
    if parameter is None:
        raise ObjectionError("invalid", "a unit has the parameters 1 to 40", unit=action.unit)
    _check_value(parameter, action)
    if parameter.not_while_running and _is_running(now.bus.units[action.unit], now.bus):
        reason = f"#{parameter.number} {parameter.name} cannot be changed while the unit's run input is on"
        raise ObjectionError("invalid", reason, unit=action.unit)
    for unit, raw, kind in setpoints_judged(action, now.bus):
        check_setpoint(unit, raw, now, kind)
    danger = danger_of_writing(parameter, action.raw)
    if danger and not now.confirm:
        raise ObjectionError("dangerous", danger, unit=action.unit)


def _check_value(parameter: Parameter, action: WriteParameter) -> None:
    try:
        check_writable_value(parameter, action.raw)
    except CallerError as error:
        nearest = error.nearest if isinstance(error, IllegalValue) else None
        raise ObjectionError("invalid", str(error), unit=action.unit, nearest=nearest) from error


def _check_baud(action: ChangeBaud, now: Circumstances) -> None:
    if action.baud not in BAUDS:
        nearest = min(BAUDS, key=lambda baud: abs(baud - action.baud))
        raise ObjectionError(
            "invalid", f"a unit speaks at {', '.join(map(str, BAUDS))} baud", nearest=nearest
        )
    if not now.confirm:
        raise ObjectionError("dangerous", "every unit changes its baud; one that does not follow is cut off")


def _is_running(live: UnitLive, bus: BusLive) -> bool:
    reading = live.reading
    if reading is None:
        return False
    return status_bits(reading.outputs, reading.inputs, bus.settings.estop_healthy).run

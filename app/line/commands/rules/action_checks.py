"""The checks of single kinds of command, before those that all kinds share. Pure.

Each raises Problem. Only the unit can decide on a write in LOCAL and on an analog output that is not
set for the link: these are sent, and refused by the unit.
"""

from __future__ import annotations

from app.line.commands.rules.objection import RuleContext, objection
from app.line.commands.safeguards.limits import HIGHEST_SETPOINT
from app.line.live.state.bus_live import BusLive, UnitLive
from bus.catalogue.numbers import ANALOG_OUT_HIGH, ANALOG_OUT_LOW
from bus.catalogue.parameter import IllegalValue, Parameter, check_writable_value
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import OUTPUT_NUMBERS, status_bits
from bus.contract import ChangeBaud, SetLine, WriteAnalogOutput, WriteOutput, WriteParameter
from bus.errors import CallerError
from bus.messages import Message
from bus.settings import BAUDS


def check_line(action: SetLine, _: RuleContext) -> None:
    """A change of the line names at least one unit."""
    if not action.setpoints:
        raise objection("invalid", Message("setpoints_missing"))


def check_output(action: WriteOutput, _: RuleContext) -> None:
    """A unit has six outputs."""
    if action.number not in OUTPUT_NUMBERS:
        raise objection("invalid", Message("no_such_output"), unit=action.unit)


def check_analog_output(action: WriteAnalogOutput, now: RuleContext) -> None:
    """The analog output takes #29 to #30, as far as they are known."""
    live = now.bus.units[action.unit]
    low, high = live.parameter_raw(ANALOG_OUT_LOW), live.parameter_raw(ANALOG_OUT_HIGH)
    lowest = 0 if low is None else low
    highest = HIGHEST_SETPOINT if high is None else max(lowest, high)
    if lowest <= action.raw <= highest:
        return
    nearest = min(max(action.raw, lowest), highest)
    raise objection(
        "invalid",
        Message.of(
            "analog_output_outside", unit=action.unit, lowest=lowest, highest=highest, nearest=nearest
        ),
        unit=action.unit,
        nearest=nearest,
    )


def check_parameter(action: WriteParameter, now: RuleContext) -> None:
    """A parameter has its range and choices (manual, the parameter list), and the unit must allow it now."""
    parameter = PARAMETERS.get(action.number)
    if parameter is None:
        raise objection("invalid", Message("no_such_parameter"), unit=action.unit)
    _check_value(parameter, action)
    if parameter.not_while_running and _is_running(now.bus.units[action.unit], now.bus):
        reason = Message.of("parameter_not_while_running", number=parameter.number, called=parameter.name)
        raise objection("invalid", reason, unit=action.unit)


def _check_value(parameter: Parameter, action: WriteParameter) -> None:
    try:
        check_writable_value(parameter, action.raw)
    except CallerError as error:
        nearest = error.nearest if isinstance(error, IllegalValue) else None
        raise objection("invalid", error.message, unit=action.unit, nearest=nearest) from error


def check_baud(action: ChangeBaud, _: RuleContext) -> None:
    """A unit can be set to few baud rates (#18)."""
    if action.baud not in BAUDS:
        nearest = min(BAUDS, key=lambda baud: abs(baud - action.baud))
        raise objection(
            "invalid", Message.of("baud_unknown", rates=", ".join(map(str, BAUDS))), nearest=nearest
        )


def _is_running(live: UnitLive, bus: BusLive) -> bool:
    reading = live.reading
    if reading is None:
        return False
    return status_bits(reading.outputs, reading.inputs, bus.settings.estop_healthy).run

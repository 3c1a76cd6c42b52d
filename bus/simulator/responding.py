"""What one request does to a unit, and how the unit responds.

The rules, with their places in the manual:

* reads get a response in every mode, writes only in REMOTE, else NAK 80h (1.0, and every write command);
* nothing on the link leads out of LOCAL or KEYLOCK (4.0 ***), because that would be a write;
* a speed above #2, or a ratio outside #38-#31 in a follower, is NAK 81h;
* #8 while RUN is on, any set-up while RUN is on and #16 is 0, and #17 always, are NAK 83h: the parameter
  is there and can be read, so no value is legal now, and 82h would mean that the number does not exist;
* 88h needs #28 = 2, else NAK 87h, and a value from #29 to #30, else NAK 88h;
* an unknown command, or one with the wrong amount of data, is NAK 89h.
"""

from __future__ import annotations

from dataclasses import dataclass

from bus.catalogue import parameters as numbers
from bus.errors import UnitErrorCode
from bus.simulator.unit import Mode, Unit, width_by_type
from bus.wire.commands import (
    Ack,
    ExecuteSpeedRequest,
    IllegalRequest,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    WriteAnalogOutputRequest,
    WriteOutputRequest,
    WriteParameterRequest,
    parse_request,
)

ALL_UNITS = 0
"""The UID of an 83h to every unit, which has no response."""

Rejection = UnitErrorCode | None


@dataclass(frozen=True, slots=True)
class Turn:
    """The effect of a request. ``acted``: a write was carried out; ``reply`` None: no response."""

    reply: Reply | None
    acted: bool


def respond(unit: Unit, body: bytes) -> Turn:
    """Carry out one request that reached ``unit``; ``body`` is what stood between STX and DLE ETX."""
    try:
        request = parse_request(body, unit.traits.dialect)
    except IllegalRequest as error:
        return Turn(_refuse_illegal(unit, error), acted=False)
    if request.unit == ALL_UNITS:
        acted = isinstance(request, ExecuteSpeedRequest) and _write(unit, request) is None
        return Turn(None, acted)
    match request:
        case ReadStatusRequest():
            return Turn(unit.status(request.unit), acted=False)
        case ReadParameterRequest():
            return Turn(_read(unit, request), acted=False)
    refusal = _write(unit, request)
    if refusal is not None:
        return Turn(Nak(request.unit, refusal), acted=False)
    written = b""
    if isinstance(request, WriteParameterRequest) and unit.traits.responds_with_written_value:
        written = request.raw.to_bytes(4, "big")
    return Turn(Ack(request.unit, written), acted=True)


def _refuse_illegal(unit: Unit, error: IllegalRequest) -> Reply | None:
    """A command that is none is that in every mode; a malformed value matters only where it could count."""
    if error.unit == ALL_UNITS:
        return None
    if error.code == UnitErrorCode.ILLEGAL_OUTPUT_VALUE and unit.mode is not Mode.REMOTE:
        return Nak(error.unit, UnitErrorCode.NOT_REMOTE)
    return Nak(error.unit, error.code)


def _read(unit: Unit, request: ReadParameterRequest) -> Reply:
    if not unit.has(request.number):
        return Nak(request.unit, UnitErrorCode.ILLEGAL_PARAMETER_NUMBER)
    width = unit.traits.dialect.parameter_reply_bytes or width_by_type(request.number)
    return ParameterReply(request.unit, unit.memory[request.number] & (1 << 8 * width) - 1, width)


def _write(unit: Unit, request: Request) -> Rejection:
    if unit.mode is not Mode.REMOTE:
        return UnitErrorCode.NOT_REMOTE
    match request:
        case StageSpeedRequest(raw=raw):
            return _enter(unit, raw)
        case ExecuteSpeedRequest():
            unit.setpoint = unit.entered
            return None
        case SetAndExecuteSpeedRequest(raw=raw):
            refusal = _enter(unit, raw)
            if refusal is None:
                unit.setpoint = raw
            return refusal
        case WriteParameterRequest(number=number, raw=raw):
            return _write_parameter(unit, number, raw)
        case WriteOutputRequest(output=output, on=on):
            if not 1 <= output <= len(unit.outputs):
                return UnitErrorCode.ILLEGAL_OUTPUT_NUMBER
            unit.outputs[output - 1] = on
            return None
        case WriteAnalogOutputRequest(raw=raw):
            return _write_analog(unit, raw)
    return UnitErrorCode.ILLEGAL_COMMAND


def _enter(unit: Unit, raw: int) -> Rejection:
    if not unit.lowest <= raw <= unit.highest:
        return UnitErrorCode.ILLEGAL_SPEED
    unit.entered = raw
    return None


def _write_parameter(unit: Unit, number: int, raw: int) -> Rejection:
    if not unit.has(number):
        return UnitErrorCode.ILLEGAL_PARAMETER_NUMBER
    if number == numbers.OWN_ADDRESS or _locked_by_run(unit, number) or not unit.memory.takes(number, raw):
        return UnitErrorCode.ILLEGAL_PARAMETER_VALUE
    unit.memory[number] = raw
    if number == numbers.FOLLOWER_MODE:
        unit.entered = unit.setpoint
    if number == numbers.BAUD_RATE and unit.traits.baud_changes == "at once":
        unit.baud = raw * 100
    return None


def _locked_by_run(unit: Unit, number: int) -> bool:
    if not unit.inputs.run or number in (numbers.SPEED_SETPOINT, numbers.RATIO_SETPOINT):
        return False
    return number == numbers.FOLLOWER_MODE or not unit.memory[numbers.SETUP_DURING_RUN]


def _write_analog(unit: Unit, raw: int) -> Rejection:
    if unit.memory[numbers.ANALOG_OUT_SOURCE] != 2:
        return UnitErrorCode.ANALOG_OUTPUT_NOT_COMMANDED_BY_LINK
    if not unit.memory[numbers.ANALOG_OUT_LOW] <= raw <= unit.memory[numbers.ANALOG_OUT_HIGH]:
        return UnitErrorCode.ILLEGAL_ANALOG_VALUE
    unit.analog_output = raw
    return None

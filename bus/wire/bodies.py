"""The commands and their responses as bytes, in both directions (manual, the command pages).

A *body* is what a frame carries: ``[UID][CMD][data]`` from the host, ``[UID][ACK][data]`` or
``[UID][NAK][ERR]`` from a unit. All numbers are most significant byte first.

``encode_request`` rejects what the manual's ranges exclude, so that a bad value never reaches the wire;
``parse_request``, the unit's side, takes whatever can arrive and leaves the ranges to the unit.
"""

from __future__ import annotations

from bus.errors import CallerError, LinesideError, UnitErrorCode
from bus.messages import Message
from bus.settings import Dialect
from bus.wire.commands import (
    LARGEST_VALUE,
    TRAITS,
    Ack,
    ExecuteSpeedRequest,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    StatusReply,
    WriteAnalogOutputRequest,
    WriteOutputRequest,
    WriteParameterRequest,
)
from bus.wire.framing import ACK, NAK, encode_frame
from bus.wire.lengths import acknowledged_lengths


class IllegalRequest(LinesideError):
    """A unit received a frame that is no request; ``code`` is the NAK the manual has for it."""

    def __init__(self, unit: int, code: int, message: Message) -> None:
        super().__init__(message)
        self.unit = unit
        self.code = code


# --- the host's side of a request ----------------------------------------------------------------


def encode_request(request: Request, dialect: Dialect) -> bytes:
    """The frame to send. Raises CallerError for an address, number or value outside the manual's ranges."""
    return encode_frame(request_body(request, dialect), dialect)


def request_body(request: Request, dialect: Dialect) -> bytes:
    """Return what the frame of ``request`` carries, unstuffed. Raises CallerError like ``encode_request``."""
    lowest = 0 if isinstance(request, ExecuteSpeedRequest) else 1
    _require(Message("field_unit_address"), request.unit, lowest, 255)
    return bytes((request.unit, request.COMMAND)) + _request_data(request, dialect)


def _request_data(request: Request, dialect: Dialect) -> bytes:
    match request:
        case ReadStatusRequest() | ExecuteSpeedRequest():
            return b""
        case StageSpeedRequest() | SetAndExecuteSpeedRequest() | WriteAnalogOutputRequest():
            return _value(request.raw)
        case ReadParameterRequest():
            return _number_byte(request.number, dialect)
        case WriteParameterRequest():
            return _number_byte(request.number, dialect) + _value(request.raw)
        case WriteOutputRequest():
            _require(Message("field_output"), request.output, 1, 6)
            return bytes((request.output, request.on))


def _value(raw: int) -> bytes:
    _require(Message("field_value"), raw, 0, LARGEST_VALUE)
    return raw.to_bytes(4, "big")


def _number_byte(number: int, dialect: Dialect) -> bytes:
    if dialect.parameter_numbers == "bcd":
        _require(Message("field_parameter_number"), number, 1, 99)
        return bytes((number // 10 * 16 + number % 10,))
    _require(Message("field_parameter_number"), number, 1, 255)
    return bytes((number,))


def _require(field: Message, value: int, lowest: int, highest: int) -> None:
    if not lowest <= value <= highest:
        raise CallerError(
            Message.of("request_out_of_range", field=field, value=value, lowest=lowest, highest=highest)
        )


# --- the unit's side of a request ----------------------------------------------------------------

_VALUE_COMMANDS: dict[int, type[StageSpeedRequest | SetAndExecuteSpeedRequest | WriteAnalogOutputRequest]] = {
    command.COMMAND: command
    for command in (StageSpeedRequest, SetAndExecuteSpeedRequest, WriteAnalogOutputRequest)
}


def is_request(body: bytes) -> bool:
    """Return whether ``body`` has the shape of a request; a response has 06h or 15h as its second byte."""
    return len(body) >= 2 and body[1] in TRAITS and TRAITS[body[1]].data_bytes == len(body) - 2


def parse_request(body: bytes, dialect: Dialect) -> Request:
    """Parse a request to the unit body[0]; values are not checked.

    Raises IllegalRequest, with the error code that a unit would return, for an unknown command, a wrong
    length, a parameter number that is not BCD where the dialect uses BCD, or an output value other than 0 or
    1.
    """
    unit, command = body[0], body[1]
    if not is_request(body):
        message = Message.of("command_unknown", command=f"{command:02X}")
        raise IllegalRequest(unit, UnitErrorCode.ILLEGAL_COMMAND, message)
    data = body[2:]
    if command in _VALUE_COMMANDS:
        return _VALUE_COMMANDS[command](unit, int.from_bytes(data, "big"))
    match command:
        case ReadStatusRequest.COMMAND:
            return ReadStatusRequest(unit)
        case ExecuteSpeedRequest.COMMAND:
            return ExecuteSpeedRequest(unit)
        case ReadParameterRequest.COMMAND:
            return ReadParameterRequest(unit, _number(unit, data[0], dialect))
        case WriteParameterRequest.COMMAND:
            return WriteParameterRequest(
                unit, _number(unit, data[0], dialect), int.from_bytes(data[1:], "big")
            )
    if data[1] > 1:
        message = Message.of("output_value_illegal", value=data[1])
        raise IllegalRequest(unit, UnitErrorCode.ILLEGAL_OUTPUT_VALUE, message)
    return WriteOutputRequest(unit, data[0], data[1] == 1)


def _number(unit: int, byte: int, dialect: Dialect) -> int:
    if dialect.parameter_numbers == "binary":
        return byte
    tens, ones = divmod(byte, 16)
    if tens > 9 or ones > 9:
        message = Message.of("number_not_bcd", byte=f"{byte:02X}")
        raise IllegalRequest(unit, UnitErrorCode.ILLEGAL_PARAMETER_NUMBER, message)
    return tens * 10 + ones


# --- responses -----------------------------------------------------------------------------------


def encode_reply(reply: Reply, dialect: Dialect) -> bytes:
    """The unit's frame. Raises CallerError where a field does not fit its bytes."""
    return encode_frame(reply_body(reply, dialect), dialect)


def reply_body(reply: Reply, dialect: Dialect) -> bytes:
    """Return what the frame of ``reply`` carries, unstuffed. Raises CallerError like ``encode_reply``."""
    mark = NAK if isinstance(reply, Nak) else ACK
    try:
        return bytes((reply.unit, mark)) + _reply_data(reply, dialect)
    except (OverflowError, ValueError) as error:
        raise CallerError(Message.of("reply_does_not_fit", reply=str(reply), error=str(error))) from error


def _reply_data(reply: Reply, dialect: Dialect) -> bytes:
    match reply:
        case StatusReply():
            speeds = reply.commanded.to_bytes(4, "big") + reply.actual.to_bytes(4, "big")
            return speeds + bytes((reply.analog, reply.outputs, reply.inputs))
        case Ack():
            return reply.data
        case Nak():
            return bytes((reply.code,))
        case ParameterReply():
            return reply.raw.to_bytes(dialect.parameter_reply_bytes or reply.width, "big")


def parse_reply(request: Request, body: bytes, dialect: Dialect) -> Reply | None:
    """Parse ``body`` as the response to ``request``; None if it cannot be one.

    The address must be that of the request, and the length one that the command's response may have. Unit 0
    never responds. The manual draws the response to 86h as ``[UID][DAT]`` without an ACK; such a body is not
    taken, because nothing in it marks it as a response (the manual's text has the ACK, and the write is read
    back by 85h in any case).
    """
    if len(body) < 2 or body[0] != request.unit or request.unit == 0:
        return None
    mark, data = body[1], body[2:]
    if mark == NAK:
        return Nak(request.unit, data[0]) if len(data) == 1 else None
    if mark != ACK or len(data) not in acknowledged_lengths(request, dialect):
        return None
    match request:
        case ReadStatusRequest():
            speeds = int.from_bytes(data[:4], "big"), int.from_bytes(data[4:8], "big")
            return StatusReply(request.unit, *speeds, *data[8:])
        case ReadParameterRequest():
            return ParameterReply(request.unit, int.from_bytes(data, "big"), len(data))
        case _:
            return Ack(request.unit, data)

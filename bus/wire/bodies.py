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
    LAYOUTS,
    REQUESTS,
    Ack,
    ExecuteSpeedRequest,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    StatusReply,
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
    body = bytes((request.unit, request.COMMAND))
    for field, width in LAYOUTS[request.COMMAND].items():
        body += _encoded(field, getattr(request, field), dialect).to_bytes(width, "big")
    return body


def _encoded(field: str, value: int, dialect: Dialect) -> int:
    match field:
        case "raw":
            _require(Message("field_value"), value, 0, LARGEST_VALUE)
        case "output":
            _require(Message("field_output"), value, 1, 6)
        case "number" if dialect.parameter_numbers == "bcd":
            _require(Message("field_parameter_number"), value, 1, 99)
            return value // 10 * 16 + value % 10
        case "number":
            _require(Message("field_parameter_number"), value, 1, 255)
    return value


def _require(field: Message, value: int, lowest: int, highest: int) -> None:
    if not lowest <= value <= highest:
        raise CallerError(
            Message.of("request_out_of_range", field=field, value=value, lowest=lowest, highest=highest)
        )


# --- the unit's side of a request ----------------------------------------------------------------


def is_request(body: bytes) -> bool:
    """Return whether ``body`` has the shape of a request; a response has 06h or 15h as its second byte."""
    return len(body) >= 2 and body[1] in LAYOUTS and sum(LAYOUTS[body[1]].values()) == len(body) - 2


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
    values, data = [], body[2:]
    for field, width in LAYOUTS[command].items():
        values.append(_decoded(unit, field, int.from_bytes(data[:width], "big"), dialect))
        data = data[width:]
    return REQUESTS[command](unit, *values)


def _decoded(unit: int, field: str, value: int, dialect: Dialect) -> int:
    if field == "on":
        if value > 1:
            message = Message.of("output_value_illegal", value=value)
            raise IllegalRequest(unit, UnitErrorCode.ILLEGAL_OUTPUT_VALUE, message)
        return value == 1
    if field == "number" and dialect.parameter_numbers == "bcd":
        tens, ones = divmod(value, 16)
        if tens > 9 or ones > 9:
            message = Message.of("number_not_bcd", byte=f"{value:02X}")
            raise IllegalRequest(unit, UnitErrorCode.ILLEGAL_PARAMETER_NUMBER, message)
        return tens * 10 + ones
    return value


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

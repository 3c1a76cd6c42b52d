"""The eight commands 81h-88h and their responses, as types and as bytes (manual, the command pages).

A *body* is what a frame carries: ``[UID][CMD][data]`` from the host, ``[UID][ACK][data]`` or
``[UID][NAK][ERR]`` from a unit. All numbers are most significant byte first. ``encode_request`` rejects what
the manual's ranges exclude, so that a bad value never reaches the wire; ``parse_request``, the unit's side,
takes whatever can arrive and leaves the ranges to the unit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, NamedTuple, get_args

import msgspec

from bus.catalogue.parameters import PARAMETERS
from bus.errors import CallerError, LinesideError, UnitErrorCode
from bus.messages import Message
from bus.settings import Dialect
from bus.wire.framing import ACK, NAK, encode_frame

LARGEST_VALUE = 99999
"""0001869Fh, the end of every speed and value range on the link."""


class _UnitRequest(msgspec.Struct, frozen=True):
    unit: int


class ReadStatusRequest(_UnitRequest, frozen=True):
    """81h, which reads both speeds, analog input, outputs and inputs."""

    COMMAND: ClassVar[int] = 0x81


class StageSpeedRequest(_UnitRequest, frozen=True):
    """82h, which stages a speed until 83h takes it over. ``raw``: display units, or ratio x 10000."""

    COMMAND: ClassVar[int] = 0x82
    raw: int


class ExecuteSpeedRequest(_UnitRequest, frozen=True):
    """83h, which takes over the staged speed. Unit 0 addresses every unit at once, and none responds."""

    COMMAND: ClassVar[int] = 0x83


class SetAndExecuteSpeedRequest(_UnitRequest, frozen=True):
    """84h, which sets a speed that is effective at once."""

    COMMAND: ClassVar[int] = 0x84
    raw: int


class ReadParameterRequest(_UnitRequest, frozen=True):
    """85h, which reads a parameter."""

    COMMAND: ClassVar[int] = 0x85
    number: int


class WriteParameterRequest(_UnitRequest, frozen=True):
    """86h, which writes a parameter."""

    COMMAND: ClassVar[int] = 0x86
    number: int
    raw: int


class WriteOutputRequest(_UnitRequest, frozen=True):
    """87h, which switches auxiliary output 1-6 on or off."""

    COMMAND: ClassVar[int] = 0x87
    output: int
    on: bool


class WriteAnalogOutputRequest(_UnitRequest, frozen=True):
    """88h, which writes the analog output: needs #28 = 2 and #29 <= raw <= #30."""

    COMMAND: ClassVar[int] = 0x88
    raw: int


Request = (
    ReadStatusRequest
    | StageSpeedRequest
    | ExecuteSpeedRequest
    | SetAndExecuteSpeedRequest
    | ReadParameterRequest
    | WriteParameterRequest
    | WriteOutputRequest
    | WriteAnalogOutputRequest
)
REQUESTS: dict[int, Callable[..., Request]] = {kind.COMMAND: kind for kind in get_args(Request)}
_FIELD_BYTES = {"raw": 4, "number": 1, "output": 1, "on": 1}
LAYOUTS: dict[int, dict[str, int]] = {
    kind.COMMAND: {field: _FIELD_BYTES[field] for field in kind.__struct_fields__ if field != "unit"}
    for kind in get_args(Request)
}
"""The data of each command: its fields in their order, with the bytes of each."""


class CommandTraits(NamedTuple):
    """The properties of a command's bytes according to the manual."""

    name: str
    """The name for programs; for people there is the message ``request_…``."""
    acknowledged: frozenset[int]
    """The numbers of data bytes that an acknowledgement may have."""
    refusals: frozenset[int]
    """The error codes of its NAK, without "illegal command"."""


_NOTHING = frozenset((0,))
TRAITS = {
    0x81: CommandTraits("read_status", frozenset((11,)), frozenset()),
    0x82: CommandTraits("set_speed", _NOTHING, frozenset((0x80, 0x81))),
    0x83: CommandTraits("execute_speed", _NOTHING, frozenset((0x80,))),
    0x84: CommandTraits("set_and_execute_speed", _NOTHING, frozenset((0x80, 0x81))),
    0x85: CommandTraits("read_parameter", frozenset((1, 2, 4)), frozenset((0x82,))),
    0x86: CommandTraits("write_parameter", frozenset((0, 1, 2, 4)), frozenset((0x80, 0x82, 0x83))),
    0x87: CommandTraits("write_output", _NOTHING, frozenset((0x80, 0x84, 0x85))),
    0x88: CommandTraits("write_analog_output", _NOTHING, frozenset((0x80, 0x87, 0x88))),
}
"""The traits by command."""


class StatusReply(msgspec.Struct, frozen=True):
    """Response to 81h. ``analog`` is ATD, ``outputs`` is ST2, ``inputs`` is ST1."""

    unit: int
    commanded: int
    actual: int
    analog: int
    outputs: int
    inputs: int


class Ack(msgspec.Struct, frozen=True):
    """The acknowledgement of a write. ``data`` is empty, but a unit may return the value of 86h."""

    unit: int
    data: bytes = b""


class Nak(msgspec.Struct, frozen=True):
    """A refusal by the unit; ``code`` is [ERR]."""

    unit: int
    code: int


class ParameterReply(msgspec.Struct, frozen=True):
    """Response to 85h; it does not name the parameter. ``width`` is the number of bytes of the value."""

    unit: int
    raw: int
    width: int = 4


Reply = StatusReply | Ack | Nak | ParameterReply


def is_write(request: Request) -> bool:
    """Return whether ``request`` can change anything in a unit."""
    return not isinstance(request, ReadStatusRequest | ReadParameterRequest)


def is_secret(request: Request) -> bool:
    """Return whether the frames of this exchange carry a value that may not be shown or kept (#21)."""
    if not isinstance(request, ReadParameterRequest | WriteParameterRequest):
        return False
    return request.number in PARAMETERS and PARAMETERS[request.number].secret


_FRAME_OVERHEAD = 5
"""The bytes around a body: 10 02 before it; 10 03 and the checksum after it."""


def acknowledged_lengths(request: Request, dialect: Dialect) -> frozenset[int]:
    """Return the number of data bytes that an ACK to ``request`` may carry."""
    width = dialect.parameter_reply_bytes
    if width and request.COMMAND == ReadParameterRequest.COMMAND:
        return frozenset((width,))
    return TRAITS[request.COMMAND].acknowledged


def usual_reply_bytes(request: Request, dialect: Dialect) -> int:
    """Return the bytes on the wire of an ordinary response without a 10h; 0 for a broadcast."""
    return _reply_bytes(request, dialect, bytes_per_byte=1)


def least_reply_bytes(request: Request, dialect: Dialect) -> int:
    """Return the bytes on the wire of the shortest acknowledgement; 0 for a broadcast."""
    if request.unit == 0:
        return 0
    return _FRAME_OVERHEAD + 2 + min(acknowledged_lengths(request, dialect))


def longest_reply_bytes(request: Request, dialect: Dialect) -> int:
    """Return the bytes on the wire of the longest response, every byte of it 10h; 0 for a broadcast."""
    doubled_checksum = 1 if request.unit and dialect.checksum_10h == "twice" else 0
    return _reply_bytes(request, dialect, bytes_per_byte=2) + doubled_checksum


def _reply_bytes(request: Request, dialect: Dialect, bytes_per_byte: int) -> int:
    if request.unit == 0:
        return 0
    nak_data = 1
    data = max(nak_data, *acknowledged_lengths(request, dialect))
    return _FRAME_OVERHEAD + bytes_per_byte * (2 + data)


class IllegalRequest(LinesideError):
    """Raised when a unit receives a frame that is no request; ``code`` is the NAK to return."""

    def __init__(self, unit: int, code: int, message: Message) -> None:
        super().__init__(message)
        self.unit = unit
        self.code = code


# --- the host's side of a request ----------------------------------------------------------------


def encode_request(request: Request, dialect: Dialect) -> bytes:
    """Return the frame to send. Raise CallerError for an address, number or value outside the manual's
    ranges."""
    return encode_frame(request_body(request, dialect), dialect)


def request_body(request: Request, dialect: Dialect) -> bytes:
    """Return the unstuffed body of the frame of ``request``. Raise CallerError like ``encode_request``."""
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

    Raise IllegalRequest, with the error code that a unit would return, for an unknown command, a wrong
    length, a parameter number that is not BCD although the dialect uses BCD, or an output value other than 0
    or 1.
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
    """Return the unit's frame. Raise CallerError if a field does not fit its bytes."""
    return encode_frame(reply_body(reply, dialect), dialect)


def reply_body(reply: Reply, dialect: Dialect) -> bytes:
    """Return the unstuffed body of the frame of ``reply``. Raise CallerError like ``encode_reply``."""
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

"""The eight commands 81h-88h and their responses as types (manual, the command pages)."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, NamedTuple, get_args

import msgspec

from bus.catalogue.parameters import PARAMETERS

LARGEST_VALUE = 99999
"""0001869Fh, the end of every speed and value range on the link."""


class _UnitRequest(msgspec.Struct, frozen=True):
    unit: int


class ReadStatusRequest(_UnitRequest, frozen=True):
    """81h: commanded and actual speed, analog input, outputs and inputs."""

    COMMAND: ClassVar[int] = 0x81


class StageSpeedRequest(_UnitRequest, frozen=True):
    """82h: into the unit's memory only; takes effect with 83h. ``raw``: display units, or ratio x 10000."""

    COMMAND: ClassVar[int] = 0x82
    raw: int


class ExecuteSpeedRequest(_UnitRequest, frozen=True):
    """83h: take over the staged speed. Unit 0 addresses every unit at once, and none of them responds."""

    COMMAND: ClassVar[int] = 0x83


class SetAndExecuteSpeedRequest(_UnitRequest, frozen=True):
    """84h: a new speed, effective now."""

    COMMAND: ClassVar[int] = 0x84
    raw: int


class ReadParameterRequest(_UnitRequest, frozen=True):
    """85h."""

    COMMAND: ClassVar[int] = 0x85
    number: int


class WriteParameterRequest(_UnitRequest, frozen=True):
    """86h."""

    COMMAND: ClassVar[int] = 0x86
    number: int
    raw: int


class WriteOutputRequest(_UnitRequest, frozen=True):
    """87h: auxiliary output 1-6 on or off, whatever it was before."""

    COMMAND: ClassVar[int] = 0x87
    output: int
    on: bool


class WriteAnalogOutputRequest(_UnitRequest, frozen=True):
    """88h: needs #28 = 2 and #29 <= raw <= #30."""

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
    """What the manual states of a command's bytes."""

    name: str
    """For programs; in words it is the message ``request_…``."""
    acknowledged: frozenset[int]
    """How many data bytes an acknowledgement may have."""
    refusals: frozenset[int]
    """[ERR] of its NAK, without "illegal command"."""


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
"""By command."""


class StatusReply(msgspec.Struct, frozen=True):
    """Response to 81h. ``analog`` is ATD, ``outputs`` is ST2, ``inputs`` is ST1."""

    unit: int
    commanded: int
    actual: int
    analog: int
    outputs: int
    inputs: int


class Ack(msgspec.Struct, frozen=True):
    """A write was acknowledged. ``data`` is empty, except for 86h, where a unit may return the value."""

    unit: int
    data: bytes = b""


class Nak(msgspec.Struct, frozen=True):
    """The unit refused; ``code`` is [ERR]."""

    unit: int
    code: int


class ParameterReply(msgspec.Struct, frozen=True):
    """Response to 85h; it does not name the parameter. ``width`` is the number of bytes of the value."""

    unit: int
    raw: int
    width: int = 4


Reply = StatusReply | Ack | Nak | ParameterReply


def is_write(request: Request) -> bool:
    """Whether ``request`` can change anything in a unit."""
    return not isinstance(request, ReadStatusRequest | ReadParameterRequest)


def is_secret(request: Request) -> bool:
    """Whether the frames of this exchange carry a value that may not be shown or kept (#21)."""
    if not isinstance(request, ReadParameterRequest | WriteParameterRequest):
        return False
    return request.number in PARAMETERS and PARAMETERS[request.number].secret

"""The actions that the app can request of a bus, their durations, and the bounds of every field of the
contract.

A new action needs a class here, a case in ``bus.line.commands.catalogue`` for how it is carried out and
verified, and a row in ``app.line.commands.catalogue`` for everything else.

Bounds are checked when a message is decoded, on both sides: neither a worker nor an app is trusted to keep to
them. NaN and the infinities are outside every range. The ranges are those of the wire (manual, the command
pages): speeds to 99999, four-byte values, one byte for each of the analog input, outputs, inputs and errors,
40 parameters, addresses 1-255.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import msgspec
from msgspec import Meta, field

from bus.instants import UnixTime
from bus.settings import wire_seconds

CONTRACT_VERSION = 6
BUFFER_AGE_S = 7 * 86_400.0
"""The largest age of an update that a worker kept while the app was away, in seconds; older ones are
refused."""

UnitLinkState = Literal["unknown", "online", "stale", "offline"]
BusLinkState = Literal["open", "closed"]
Outcome = Literal["verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed"]
Stage = Literal["waiting", "sent", "searching", "acknowledged", "proving"]
Direction = Literal["out", "in"]


class TaggedStruct(msgspec.Struct, frozen=True, tag_field="is", omit_defaults=True):
    """The base of each message and part of a message: immutable, with its type in the field ``is``."""


MAX_UNITS = 255
MAX_UPDATES = 500
"""The most updates in a batch, so that no message takes the app's loop for long."""
MAX_FRAMES = 2_000
MAX_MEANINGS = 30
MAX_REMARKS = 20
MAX_TEXT = 4_000
MAX_MEANING = 1_000
"""The most characters of the meaning of a frame."""
MAX_WORDS = 300
MAX_ID = 200
MAX_FRAME = 1_024

UnitId = Annotated[int, Meta(ge=1, le=255)]
Speed = Annotated[int, Meta(ge=0, le=99_999)]
FourBytes = Annotated[int, Meta(ge=0, le=0xFFFF_FFFF)]
Byte = Annotated[int, Meta(ge=0, le=0xFF)]
ParameterNumber = Annotated[int, Meta(ge=1, le=40)]
UnitScale = Annotated[dict[ParameterNumber, FourBytes | None], Meta(max_length=40)]
"""The parameters with which a value was converted: number → raw, None if the unit lacks it."""
OutputNumber = Annotated[int, Meta(ge=1, le=6)]
BaudRate = Annotated[int, Meta(ge=300, le=9600)]
Total = Annotated[int, Meta(ge=0, le=2**53)]

Stamp = Annotated[UnixTime, Meta(ge=0.0, le=32_503_680_000.0)]
"""Seconds since the epoch, to the year 3000; the receiver checks whether it is near enough to now."""
DurationSeconds = Annotated[float, Meta(ge=0.0, le=1e7)]
ClockDifference = Annotated[float, Meta(ge=-1e11, le=1e11)]
"""The difference of two clocks, in seconds."""
Hertz = Annotated[float, Meta(ge=0.0, le=1e6)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]

LongText = Annotated[str, Meta(max_length=MAX_TEXT)]
"""A cause, a text, or a diagnosis that names many units."""
ShortText = Annotated[str, Meta(max_length=MAX_WORDS)]
Id = Annotated[str, Meta(max_length=MAX_ID)]
FrameBytes = Annotated[bytes, Meta(max_length=MAX_FRAME)]
"""The bytes of a frame; of a longer piece of noise only the beginning is kept."""


class BusAction(TaggedStruct, frozen=True):
    """An action that addresses a bus."""

    writes: ClassVar[bool] = True
    """Whether the action can change anything in a unit."""
    returns_values: ClassVar[bool] = False
    """Whether the result has values of parameters, those of ``only_unit``."""
    most_frames: ClassVar[int] = 300
    """The most frames that the result has."""

    @property
    def units(self) -> tuple[int, ...]:
        """The units that the action names, ascending."""
        return ()

    @property
    def only_unit(self) -> int | None:
        """The only unit that the action addresses, or None."""
        return None

    @property
    def stops(self) -> bool:
        """Whether the action can only bring units to a standstill."""
        return False

    @property
    def stages(self) -> tuple[int, ...]:
        """Return the addresses of the units in which the action stages a speed (82h)."""
        return ()


class UnitAction(BusAction, frozen=True):
    """An action that addresses one unit."""

    unit: UnitId

    @property
    def units(self) -> tuple[int, ...]:
        return (self.unit,)

    @property
    def only_unit(self) -> int | None:
        return self.unit


class SetSpeed(UnitAction, frozen=True, tag="set_speed"):
    """A speed by 84h (``execute``) or 82h. ``raw``: 0-99999, display units, or for a follower ratio x
    10000."""

    raw: Speed
    execute: bool = True

    @property
    def stops(self) -> bool:
        return self.raw == 0

    @property
    def stages(self) -> tuple[int, ...]:
        return () if self.execute else self.units


class ExecuteSpeed(UnitAction, frozen=True, tag="execute_speed"):
    """83h to one unit, which takes over its staged speed."""


class ExecuteAll(BusAction, frozen=True, tag="execute_all"):
    """83h to unit 0, then a read-back of every unit."""


class SetLine(BusAction, frozen=True, tag="set_line"):
    """A change of several units: 82h to each, one 83h to unit 0, then a read-back. ``setpoints``: unit →
    raw."""

    setpoints: Annotated[dict[UnitId, Speed], Meta(max_length=MAX_UNITS)]

    @property
    def units(self) -> tuple[int, ...]:
        return tuple(sorted(self.setpoints))

    @property
    def stops(self) -> bool:
        return not any(self.setpoints.values())

    @property
    def stages(self) -> tuple[int, ...]:
        return self.units


class WriteOutput(UnitAction, frozen=True, tag="write_output"):
    """A switched output by 87h; ``number``: 1-6."""

    number: OutputNumber
    on: bool


class WriteAnalogOutput(UnitAction, frozen=True, tag="write_analog_output"):
    """An analog output by 88h: acknowledged at best, because it cannot be read back."""

    raw: FourBytes


class ReadParameters(UnitAction, frozen=True, tag="read_parameters"):
    """85h for each of ``numbers`` (all 40 if empty); if not ``urgent``, only in the gaps of the scan."""

    writes: ClassVar[bool] = False
    returns_values: ClassVar[bool] = True
    numbers: Annotated[list[ParameterNumber], Meta(max_length=40)] = field(default_factory=list)
    urgent: bool = True


class WriteParameter(UnitAction, frozen=True, tag="write_parameter"):
    """A parameter by 86h, read back by 85h. The app has checked range, access and confirmation."""

    number: ParameterNumber
    raw: FourBytes


class ChangeBaud(BusAction, frozen=True, tag="change_baud"):
    """Write #18 to every unit, follow with the port, read all back; go back if a unit is lost."""

    baud: BaudRate


class ScanBus(BusAction, frozen=True, tag="scan_bus"):
    """Find which addresses respond, in the gaps of the scan, at the present baud rate."""

    writes: ClassVar[bool] = False
    first: UnitId = 1
    last: UnitId = 255


class ReadTrace(BusAction, frozen=True, tag="read_trace"):
    """A request for the kept frames (an hour at most) from ``since`` on, oldest first, as the result's
    ``frames``: at most ``limit`` of them, so a longer span is requested in parts, from the last frame's time.
    Nothing is sent."""

    writes: ClassVar[bool] = False
    most_frames: ClassVar[int] = MAX_FRAMES
    since: Stamp
    limit: Annotated[int, Meta(ge=1, le=MAX_FRAMES)] = MAX_FRAMES


WireAction = (
    SetSpeed
    | ExecuteSpeed
    | ExecuteAll
    | SetLine
    | WriteOutput
    | WriteAnalogOutput
    | ReadParameters
    | WriteParameter
    | ChangeBaud
    | ScanBus
)
Action = WireAction | ReadTrace


POLL_BYTES = 7 + 18
"""The bytes of 81h and its response."""
_STAGE_BYTES = 11
"""The bytes of 82h with four data bytes."""
_DOUBLED_BYTES = 4
"""The bytes that 82h grows by if every data byte is 10h."""
_ACK_BYTES = 7
_EXECUTE_BYTES = 7
_READ_BYTES = 8 + 8
"""The bytes of 85h and a response with a value of one byte."""
_LONG_VALUE_BYTES = 7
"""The bytes that the response to 85h grows by for a value of four bytes 10h."""


def stage_s(baud: int, reads: int = 0) -> float:
    """Return the least seconds that staging one of several units takes: ``reads`` of its parameters, 82h and
    the acknowledgement."""
    return wire_seconds(_STAGE_BYTES + _ACK_BYTES + reads * _READ_BYTES, baud)


def longest_stage_s(baud: int, turnaround_s: float, reads: int = 0) -> float:
    """Return the most seconds that a stage takes without a retry. ``turnaround_s``: how long a unit may take
    to begin its response."""
    stage = wire_seconds(_STAGE_BYTES + _DOUBLED_BYTES + _ACK_BYTES, baud) + turnaround_s
    return stage + reads * (wire_seconds(_READ_BYTES + _LONG_VALUE_BYTES, baud) + turnaround_s)


def change_s(units: int, baud: int) -> float:
    """Return the least seconds that it takes to stage each of ``units``, broadcast once and read each
    back."""
    return units * stage_s(baud) + wire_seconds(_EXECUTE_BYTES + units * POLL_BYTES, baud)

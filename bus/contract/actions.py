"""What the app can ask of a bus: from the app to the worker."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, field

from bus.contract.bounds import (
    MOST_FRAMES,
    MOST_UNITS,
    Baud,
    FourBytes,
    OutputNumber,
    ParameterNumber,
    Speed,
    Stamp,
    UnitId,
)
from bus.contract.message import Message


class SetSpeed(Message, frozen=True, tag="set_speed"):
    """84h (``execute``) or 82h. ``raw``: 0-99999, display units, or a ratio times 10000 for a follower."""

    unit: UnitId
    raw: Speed
    execute: bool = True


class ExecuteSpeed(Message, frozen=True, tag="execute_speed"):
    """83h to one unit."""

    unit: UnitId


class ExecuteAll(Message, frozen=True, tag="execute_all"):
    """83h to UID 0, then the proof from every unit."""


class SetLine(Message, frozen=True, tag="set_line"):
    """Stage each (82h), require every ACK, one 83h to UID 0, prove each. ``setpoints``: unit → raw."""

    setpoints: Annotated[dict[UnitId, Speed], Meta(max_length=MOST_UNITS)]


class WriteOutput(Message, frozen=True, tag="write_output"):
    """87h: ``number`` 1-6."""

    unit: UnitId
    number: OutputNumber
    on: bool


class WriteAnalogOutput(Message, frozen=True, tag="write_analog_output"):
    """88h: acknowledged at best, there is nothing to read back."""

    unit: UnitId
    raw: FourBytes


class ReadParameters(Message, frozen=True, tag="read_parameters"):
    """85h for each of ``numbers`` (all 40 when empty). Not ``urgent``: only in the gaps of the scan."""

    unit: UnitId
    numbers: Annotated[list[ParameterNumber], Meta(max_length=40)] = field(default_factory=list)
    urgent: bool = True


class WriteParameter(Message, frozen=True, tag="write_parameter"):
    """86h, read back by 85h. The app has checked range, access and confirmation."""

    unit: UnitId
    number: ParameterNumber
    raw: FourBytes


class ChangeBaud(Message, frozen=True, tag="change_baud"):
    """#18 to every unit of the bus, follow, prove all, go back if one does not answer."""

    baud: Baud


class ScanBus(Message, frozen=True, tag="scan_bus"):
    """Which addresses answer, in the gaps of the scan, at the present baud."""

    first: UnitId = 1
    last: UnitId = 255


class ReadTrace(Message, frozen=True, tag="read_trace"):
    """The kept frames (an hour at most) from ``since`` on, oldest first, as the result's ``frames``: at
    most ``limit`` of them, so a longer span is asked for again from the last one's time. Nothing is sent."""

    since: Stamp
    limit: Annotated[int, Meta(ge=1, le=MOST_FRAMES)] = MOST_FRAMES


Action = (
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
    | ReadTrace
)

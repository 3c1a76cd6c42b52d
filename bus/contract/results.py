"""How far a command is and what became of it: from the worker to the app."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, field

from bus.contract.bounds import (
    MOST_FRAMES,
    MOST_REMARKS,
    MOST_UNITS,
    BaudRate,
    Byte,
    DurationSeconds,
    FourBytes,
    Id,
    Outcome,
    Stage,
    Stamp,
    TaggedStruct,
    Total,
    UnitId,
)
from bus.contract.readings import Frame, ParameterValue
from bus.messages import Message


class Progress(TaggedStruct, frozen=True, tag="progress"):
    """How far a command has come. ``done``/``of`` count rows or addresses where there are several."""

    id: Id
    at: Stamp
    stage: Stage
    unit: UnitId | None = None
    done: Total = 0
    of: Total = 0


class UnitOutcome(TaggedStruct, frozen=True, tag="unit_outcome"):
    """The outcome of a command at one unit, with the times of its frames."""

    unit: UnitId
    outcome: Outcome
    message: Message | None = None
    unit_error: Byte | None = None
    read_back: FourBytes | None = None
    sent_at: Stamp | None = None
    acknowledged_at: Stamp | None = None
    proven_at: Stamp | None = None
    attempts: Total = 0


class FoundUnit(TaggedStruct, frozen=True, tag="found_unit"):
    """What a scan found at one address. ``kind``: digimax, garbled (two units?), foreign, or late where
    responses come too late to be attributed.
    """

    unit: UnitId
    baud: BaudRate
    kind: Literal["digimax", "garbled", "foreign", "late"]
    parameters: Annotated[list[Byte], Meta(max_length=256)] = field(default_factory=list)
    remarks: Annotated[list[Message], Meta(max_length=MOST_REMARKS)] = field(default_factory=list)


class Result(TaggedStruct, frozen=True, tag="result"):
    """The one outcome of a command. ``values``: what ReadParameters read. ``skew_s``: upper bound of the time
    between the first and the last unit's acting on one broadcast. ``frames``: the frames that carried it.
    """

    id: Id
    at: Stamp
    outcome: Outcome
    message: Message | None = None
    unit_error: Byte | None = None
    read_back: FourBytes | None = None
    units: Annotated[list[UnitOutcome], Meta(max_length=MOST_UNITS)] = field(default_factory=list)
    values: Annotated[list[ParameterValue], Meta(max_length=40)] = field(default_factory=list)
    found: Annotated[list[FoundUnit], Meta(max_length=MOST_UNITS)] = field(default_factory=list)
    skew_s: DurationSeconds | None = None
    frames: Annotated[list[Frame], Meta(max_length=MOST_FRAMES)] = field(default_factory=list)

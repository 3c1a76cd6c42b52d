"""The messages between a bus worker and the app, and nothing else that the two share.

The worker opens the WebSocket and speaks first. Its order of speech is fixed:
``Hello`` → (app) ``Welcome`` → ``Snapshot`` → the backlog the app has not had, as ``Batch`` with
``live=False`` → ``Batch`` after ``Batch``, numbered without a gap. The app answers each with
``Delivered`` so that the worker may forget it.

Times are seconds since the epoch on the speaker's own clock (float, microsecond resolution).
Speeds, parameters and analog values are the raw integers of the wire.
"""

from __future__ import annotations

from bus.contract.actions import (
    Action,
    ChangeBaud,
    ExecuteAll,
    ExecuteSpeed,
    ReadParameters,
    ReadTrace,
    ScanBus,
    SetLine,
    SetSpeed,
    UnitAction,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.contract.bounds import LONGEST_FRAME, LONGEST_MEANING, MOST_MEANINGS, MOST_UPDATES
from bus.contract.readings import (
    BusFigures,
    BusLink,
    Frame,
    Frames,
    ParameterValue,
    Reading,
    Staged,
    UnitCounts,
    UnitFigures,
    UnitLink,
    UnitState,
)
from bus.contract.results import (
    FoundUnit,
    Progress,
    Result,
    UnitOutcome,
)
from bus.contract.session import (
    AppMessage,
    Batch,
    Cancel,
    ClockSync,
    Command,
    Delivered,
    Hello,
    MalformedMessageError,
    ReserveTurn,
    Snapshot,
    Update,
    WantSnapshot,
    Watch,
    Welcome,
    WorkerMessage,
    decode_from_app,
    decode_from_worker,
    encode,
)
from bus.contract.tagged import (
    BUFFER_AGE_S,
    CONTRACT_VERSION,
    BusLinkState,
    Direction,
    Outcome,
    Stage,
    TaggedStruct,
    UnitLinkState,
)

__all__ = [
    "BUFFER_AGE_S",
    "CONTRACT_VERSION",
    "LONGEST_FRAME",
    "LONGEST_MEANING",
    "MOST_MEANINGS",
    "MOST_UPDATES",
    "Action",
    "AppMessage",
    "Batch",
    "BusFigures",
    "BusLink",
    "BusLinkState",
    "Cancel",
    "ChangeBaud",
    "ClockSync",
    "Command",
    "Delivered",
    "Direction",
    "ExecuteAll",
    "ExecuteSpeed",
    "FoundUnit",
    "Frame",
    "Frames",
    "Hello",
    "MalformedMessageError",
    "Outcome",
    "ParameterValue",
    "Progress",
    "ReadParameters",
    "ReadTrace",
    "Reading",
    "ReserveTurn",
    "Result",
    "ScanBus",
    "SetLine",
    "SetSpeed",
    "Snapshot",
    "Stage",
    "Staged",
    "TaggedStruct",
    "UnitAction",
    "UnitCounts",
    "UnitFigures",
    "UnitLink",
    "UnitLinkState",
    "UnitOutcome",
    "UnitState",
    "Update",
    "WantSnapshot",
    "Watch",
    "Welcome",
    "WorkerMessage",
    "WriteAnalogOutput",
    "WriteOutput",
    "WriteParameter",
    "decode_from_app",
    "decode_from_worker",
    "encode",
]

"""The updates of a worker to the app: values, links and figures of units, and results of commands."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

from bus.contract.actions import (
    MAX_FRAMES,
    MAX_MEANING,
    MAX_MEANINGS,
    MAX_REMARKS,
    MAX_UNITS,
    BaudRate,
    BusLinkState,
    Byte,
    Direction,
    DurationSeconds,
    FourBytes,
    FrameBytes,
    Hertz,
    Id,
    Outcome,
    ParameterNumber,
    Share,
    Stage,
    Stamp,
    TaggedStruct,
    Total,
    UnitId,
    UnitLinkState,
)
from bus.messages import Message


class Reading(TaggedStruct, frozen=True, tag="reading"):
    """A response to 81h. ``analog`` is ATD, ``outputs`` is ST2, ``inputs`` is ST1, all as sent. The app
    sets a speed beyond the manual's range to None; ``implausible`` is then what the unit sent."""

    unit: UnitId
    at: Stamp
    commanded: FourBytes | None
    actual: FourBytes | None
    analog: Byte
    outputs: Byte
    inputs: Byte
    implausible: FrameBytes = b""

    @property
    def deviation(self) -> int | None:
        """Actual minus commanded speed; None if one of them is not known."""
        return None if self.actual is None or self.commanded is None else self.actual - self.commanded


class ParameterValue(TaggedStruct, frozen=True, tag="parameter"):
    """The value of an 85h response, with its frame as on the wire for evidence. ``available`` False: NAK 82h,
    the unit does not have this parameter.
    """

    unit: UnitId
    number: ParameterNumber
    at: Stamp
    raw: FourBytes | None
    available: bool = True
    frame: FrameBytes = b""


class UnitLink(TaggedStruct, frozen=True, tag="unit_link"):
    """A change of the link to a unit: it responded, is overdue, was lost or was never seen."""

    unit: UnitId
    at: Stamp
    link: UnitLinkState
    cause: Message | None = None


class BusLink(TaggedStruct, frozen=True, tag="bus_link"):
    """The opening or closing of the port ``at`` a time, with its ``cause``. It is sent again, with the same
    ``at``, when the baud rate changes."""

    at: Stamp
    link: BusLinkState
    cause: Message | None = None
    baud: Annotated[int, Meta(ge=0, le=9600)] = 0
    """The present rate of the port, which a change of #18 may have moved; 0 from an older worker."""

    @property
    def refusal(self) -> Message:
        """The reason why nothing is sent while the port is closed."""
        if self.cause is None:
            return Message("bus_not_linked")
        return Message.of("bus_closed", reason=self.cause)


class Staged(TaggedStruct, frozen=True, tag="staged"):
    """The speed that a unit has acknowledged by 82h and not yet executed; None once executed or withdrawn.
    ``unknown``: it did not acknowledge 82h, or was away since, and what it holds cannot be read back."""

    unit: UnitId
    at: Stamp
    raw: FourBytes | None
    unknown: bool = False


class UnitState(TaggedStruct, frozen=True, tag="unit_state"):
    """The complete state of one unit that the worker knows."""

    unit: UnitId
    link: UnitLink
    reading: Reading | None = None
    parameters: Annotated[list[ParameterValue], Meta(max_length=40)] = field(default_factory=list)
    staged: FourBytes | None = None
    staged_unknown: bool = False


TROUBLED = 0.1
"""The part of its responses from which on a unit that misses or damages them has a fault."""
FEW = 3
"""The least number of events that are more than chance."""


class UnitCounts(Struct, omit_defaults=True):
    """The counts of all requests to one unit since the worker started; the worker counts in it."""

    unit: UnitId
    polls: Total = 0
    responses: Total = 0
    timeouts: Total = 0
    retries: Total = 0
    checksum_errors: Total = 0
    foreign: Total = 0
    late: Total = 0
    naks: Annotated[dict[Byte, Total], Meta(max_length=256)] = field(default_factory=dict)

    def is_fault(self, events: int) -> bool:
        """Return whether so many timeouts or damaged responses are a fault, by the threshold of the
        diagnosis."""
        return events >= FEW and events > TROUBLED * (self.responses + self.timeouts)


# The subclass is frozen although its base counts: msgspec allows that, the rule is for dataclasses.
class UnitFigures(UnitCounts, TaggedStruct, frozen=True, tag="unit_figures"):  # type: ignore[misc]
    """The counters of one unit, and its response times in seconds (request to first byte)."""

    response_s_min: DurationSeconds | None = None
    response_s_median: DurationSeconds | None = None
    response_s_p99: DurationSeconds | None = None
    response_s_max: DurationSeconds | None = None


class BusFigures(TaggedStruct, frozen=True, tag="bus_figures"):
    """The figures of the wire, about once a second. ``diagnosis``: the likely causes of faults."""

    at: Stamp
    scan_hz: Hertz
    scan_s: DurationSeconds
    wire_utilisation: Share
    scan_s_with_one_more: DurationSeconds
    noise_bytes: Total = 0
    echoes: Total = 0
    diagnosis: Annotated[list[Message], Meta(max_length=MAX_REMARKS)] = field(default_factory=list)
    units: Annotated[list[UnitFigures], Meta(max_length=MAX_UNITS)] = field(default_factory=list)
    updates_lost: Total = 0
    """Updates dropped because the app was away longer than the worker can keep them."""
    responds_for_all: Byte = 0
    """The unit that seems to respond to every address, so that each response of the others is duplicated and
    cannot be attributed; 0 if none does."""
    has_second_master: bool = False
    """Whether units respond to requests of another host on the wire; nothing is written then."""
    unrequested: Total = 0
    """Responses that no request of this host explains, not even an old one."""


class Frame(TaggedStruct, frozen=True, tag="frame"):
    """A frame (or piece of noise) as it passed the port, with its meaning."""

    at: Stamp
    direction: Direction
    data: FrameBytes
    meanings: Annotated[list[Message], Meta(max_length=MAX_MEANINGS)]
    valid: bool = True

    @property
    def meaning(self) -> str:
        return "; ".join(map(str, self.meanings))[:MAX_MEANING]


class Frames(TaggedStruct, frozen=True, tag="frames"):
    """Frames of the trace, sent only while someone follows it."""

    frames: Annotated[list[Frame], Meta(max_length=MAX_FRAMES)]


class Progress(TaggedStruct, frozen=True, tag="progress"):
    """The progress of a command. ``done``/``of`` count rows or addresses if there are several."""

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
    """The device that a scan found at one address. ``kind``: digimax, garbled (two units?), foreign, or late
    if responses come too late to be attributed."""

    unit: UnitId
    baud: BaudRate
    kind: Literal["digimax", "garbled", "foreign", "late"]
    parameters: Annotated[list[Byte], Meta(max_length=256)] = field(default_factory=list)
    remarks: Annotated[list[Message], Meta(max_length=MAX_REMARKS)] = field(default_factory=list)


class Result(TaggedStruct, frozen=True, tag="result"):
    """The one outcome of a command. ``values``: the parameters that were read. ``skew_s``: upper bound of the
    time between the first and the last unit's acting on one broadcast. ``frames``: the frames that carried
    it."""

    id: Id
    at: Stamp
    outcome: Outcome
    message: Message | None = None
    unit_error: Byte | None = None
    read_back: FourBytes | None = None
    units: Annotated[list[UnitOutcome], Meta(max_length=MAX_UNITS)] = field(default_factory=list)
    values: Annotated[list[ParameterValue], Meta(max_length=40)] = field(default_factory=list)
    found: Annotated[list[FoundUnit], Meta(max_length=MAX_UNITS)] = field(default_factory=list)
    skew_s: DurationSeconds | None = None
    frames: Annotated[list[Frame], Meta(max_length=MAX_FRAMES)] = field(default_factory=list)


Update = Reading | ParameterValue | UnitLink | BusLink | Staged | BusFigures | Progress | Result | Frames

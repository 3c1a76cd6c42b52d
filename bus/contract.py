"""The messages between a bus worker and the app, and nothing else that the two share.

The worker opens the WebSocket and speaks first. Its order of speech is fixed:
``Hello`` → (app) ``Welcome`` → ``Snapshot`` → the backlog the app has not had, as ``Batch`` with
``live=False`` → ``Batch`` after ``Batch``, numbered without a gap. The app answers each with
``Delivered`` so that the worker may forget it.

Times are seconds since the epoch on the speaker's own clock (float, microsecond resolution).
Speeds, parameters and analog values are the raw integers of the wire.
"""

from __future__ import annotations

from typing import Literal

import msgspec

CONTRACT_VERSION = 1

UnitLinkState = Literal["unknown", "online", "stale", "offline"]
BusLinkState = Literal["open", "closed"]
Outcome = Literal["verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed"]
Stage = Literal["waiting", "sent", "acknowledged", "proving"]
Direction = Literal["out", "in"]


class Message(msgspec.Struct, frozen=True, tag_field="is", omit_defaults=True):
    """Base of every message and part of a message: immutable, told apart by its ``is`` field."""


# --- readings and states: worker → app -----------------------------------------------------------


class Reading(Message, frozen=True, tag="reading"):
    """One answer to 81h. ``analog`` is ATD, ``outputs`` is ST2, ``inputs`` is ST1, all as sent."""

    unit: int
    at: float
    commanded: int
    actual: int
    analog: int
    outputs: int
    inputs: int


class ParameterValue(Message, frozen=True, tag="parameter"):
    """What 85h answered, and the very frame that said so (``frame``, as on the wire, for evidence).
    ``available`` False: the unit said NAK 82h, it does not have this one."""

    unit: int
    number: int
    at: float
    raw: int | None
    available: bool = True
    frame: bytes = b""


class UnitLink(Message, frozen=True, tag="unit_link"):
    """A unit was heard, is overdue, was lost or was never seen."""

    unit: int
    at: float
    link: UnitLinkState
    cause: str = ""


class BusLink(Message, frozen=True, tag="bus_link"):
    """The port was opened or closed; ``cause`` says why in words."""

    at: float
    link: BusLinkState
    cause: str = ""


class Staged(Message, frozen=True, tag="staged"):
    """The speed a unit has acknowledged by 82h and not yet executed; None once executed or withdrawn."""

    unit: int
    at: float
    raw: int | None


class UnitFigures(Message, frozen=True, tag="unit_figures"):
    """Counters of one unit since the worker started; answer times in seconds (first byte after request)."""

    unit: int
    polls: int = 0
    answers: int = 0
    timeouts: int = 0
    retries: int = 0
    checksum_errors: int = 0
    foreign: int = 0
    late: int = 0
    naks: dict[int, int] = {}
    answer_s_min: float | None = None
    answer_s_median: float | None = None
    answer_s_p99: float | None = None
    answer_s_max: float | None = None


class BusFigures(Message, frozen=True, tag="bus_figures"):
    """What the wire carries, about once a second. ``diagnosis`` is the likely cause of trouble in words."""

    at: float
    scan_hz: float
    scan_s: float
    wire_utilisation: float
    scan_s_with_one_more: float
    noise_bytes: int = 0
    echoes: int = 0
    diagnosis: str = ""
    units: list[UnitFigures] = []
    updates_lost: int = 0
    """Readings and news dropped because the app was away longer than the worker can keep them."""
    baud: int = 0
    """The rate that the port goes at now, which a change of #18 may have moved; 0 from an older worker."""


class Frame(Message, frozen=True, tag="frame"):
    """One frame (or piece of rubbish) as it passed the port, with its meaning in words."""

    at: float
    direction: Direction
    data: bytes
    meaning: str
    valid: bool = True


class Progress(Message, frozen=True, tag="progress"):
    """How far a command has come. ``done``/``of`` count rows or addresses where there are several."""

    id: str
    at: float
    stage: Stage
    unit: int | None = None
    done: int = 0
    of: int = 0


class UnitOutcome(Message, frozen=True, tag="unit_outcome"):
    """The fate of a command at one unit, with the times of its frames."""

    unit: int
    outcome: Outcome
    message: str = ""
    unit_error: int | None = None
    read_back: int | None = None
    sent_at: float | None = None
    acknowledged_at: float | None = None
    proven_at: float | None = None
    attempts: int = 0


class FoundUnit(Message, frozen=True, tag="found_unit"):
    """What a scan saw at one address. ``kind``: digimax, garbled (two units?), foreign."""

    unit: int
    baud: int
    kind: Literal["digimax", "garbled", "foreign"]
    parameters: list[int] = []
    remarks: list[str] = []


class Result(Message, frozen=True, tag="result"):
    """The one fate of a command. ``values``: what ReadParameters read. ``skew_s``: upper bound of the
    time between the first and the last unit's acting on one broadcast. ``frames``: what carried it."""

    id: str
    at: float
    outcome: Outcome
    message: str = ""
    unit_error: int | None = None
    read_back: int | None = None
    units: list[UnitOutcome] = []
    values: list[ParameterValue] = []
    found: list[FoundUnit] = []
    skew_s: float | None = None
    frames: list[Frame] = []


class Frames(Message, frozen=True, tag="frames"):
    """Trace, sent only while someone follows it."""

    frames: list[Frame]


Update = Reading | ParameterValue | UnitLink | BusLink | Staged | BusFigures | Progress | Result | Frames


class UnitState(Message, frozen=True, tag="unit_state"):
    """All that the worker knows of one unit now."""

    unit: int
    link: UnitLink
    reading: Reading | None = None
    parameters: list[ParameterValue] = []
    staged: int | None = None


class Hello(Message, frozen=True, tag="hello"):
    """First word of a worker. ``worker`` is new at every start, so sequence numbers belong to it."""

    version: int
    bus: str
    worker: str
    started_at: float
    software: str
    port: str
    sent_at: float


class Snapshot(Message, frozen=True, tag="snapshot"):
    """The whole present state; ``seq`` is the number of the last update it includes."""

    seq: int
    sent_at: float
    bus: BusLink
    units: list[UnitState]
    figures: BusFigures | None = None


class Batch(Message, frozen=True, tag="batch"):
    """Updates in order. ``live`` False: kept while the app was away; they belong to history only."""

    seq: int
    sent_at: float
    updates: list[Update]
    live: bool = True


WorkerMessage = Hello | Snapshot | Batch


# --- commands: app → worker ----------------------------------------------------------------------


class SetSpeed(Message, frozen=True, tag="set_speed"):
    """84h (``execute``) or 82h. ``raw``: 0-99999, display units, or a ratio times 10000 for a follower."""

    unit: int
    raw: int
    execute: bool = True


class ExecuteSpeed(Message, frozen=True, tag="execute_speed"):
    """83h to one unit."""

    unit: int


class ExecuteAll(Message, frozen=True, tag="execute_all"):
    """83h to UID 0, then the proof from every unit."""


class SetLine(Message, frozen=True, tag="set_line"):
    """Stage each (82h), require every ACK, one 83h to UID 0, prove each. ``setpoints``: unit → raw."""

    setpoints: dict[int, int]


class WriteOutput(Message, frozen=True, tag="write_output"):
    """87h: ``number`` 1-6."""

    unit: int
    number: int
    on: bool


class WriteAnalogOutput(Message, frozen=True, tag="write_analog_output"):
    """88h: acknowledged at best, there is nothing to read back."""

    unit: int
    raw: int


class ReadParameters(Message, frozen=True, tag="read_parameters"):
    """85h for each of ``numbers`` (all 40 when empty). Not ``urgent``: only in the gaps of the scan."""

    unit: int
    numbers: list[int] = []
    urgent: bool = True


class WriteParameter(Message, frozen=True, tag="write_parameter"):
    """86h, read back by 85h. The app has checked range, access and confirmation."""

    unit: int
    number: int
    raw: int


class ChangeBaud(Message, frozen=True, tag="change_baud"):
    """#18 to every unit of the bus, follow, prove all, go back if one does not answer."""

    baud: int


class ScanBus(Message, frozen=True, tag="scan_bus"):
    """Which addresses answer, in the gaps of the scan, at the present baud."""

    first: int = 1
    last: int = 255


class ReadTrace(Message, frozen=True, tag="read_trace"):
    """The kept frames (an hour at most) from ``since`` on, oldest first, as the result's ``frames``: at
    most ``limit`` of them, so a longer span is asked for again from the last one's time. Nothing is sent."""

    since: float
    limit: int = 2000


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


class Command(Message, frozen=True, tag="command"):
    """A wish with an identity and a last moment. ``deadline``: on the app's clock, the last instant at
    which a frame that writes may leave (the worker knows that clock by ``Clock``).
    A worker carries out an id once; asked again, it repeats the fate."""

    id: str
    deadline: float
    action: Action


class Cancel(Message, frozen=True, tag="cancel"):
    """Give up a command at the next point where nothing is half done."""

    id: str


class Welcome(Message, frozen=True, tag="welcome"):
    """The app's answer to Hello. ``seq``: the last batch it has of this very worker (0: none)."""

    version: int
    seq: int
    app_time: float
    refused: str = ""


class Delivered(Message, frozen=True, tag="delivered"):
    """Everything up to ``seq`` is safe with the app; the worker may forget it."""

    seq: int


class Clock(Message, frozen=True, tag="clock"):
    """The app's time, about once a second: the worker keeps the least delay it has seen, so that a
    command held up on the way is known to be late."""

    app_time: float


class Watch(Message, frozen=True, tag="watch"):
    """The units on a page that someone has open, and whether someone follows the trace."""

    units: list[int]
    trace: bool = False


class WantSnapshot(Message, frozen=True, tag="want_snapshot"):
    """A number was missing: say everything again."""


AppMessage = Welcome | Delivered | Clock | Watch | WantSnapshot | Command | Cancel

_encoder = msgspec.msgpack.Encoder()
_worker_decoder: msgspec.msgpack.Decoder[WorkerMessage] = msgspec.msgpack.Decoder(WorkerMessage)
_app_decoder: msgspec.msgpack.Decoder[AppMessage] = msgspec.msgpack.Decoder(AppMessage)


def encode(message: WorkerMessage | AppMessage) -> bytes:
    """One binary WebSocket message."""
    return _encoder.encode(message)


def decode_from_worker(data: bytes) -> WorkerMessage:
    """Raises msgspec.DecodeError (ValidationError) when it is not a worker's message."""
    return _worker_decoder.decode(data)


def decode_from_app(data: bytes) -> AppMessage:
    """Raises msgspec.DecodeError (ValidationError) when it is not the app's message."""
    return _app_decoder.decode(data)

"""What every server knows of a line: its state, its alarms and its speed in short, never its readings.
Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated

import msgspec
from msgspec import Meta

from app.conditions.priority import AlarmPriority
from app.live.diagnosis.cause import Cause, Level
from app.live.state.onset import Onset
from bus.instants import UnixTime
from bus.messages import Message

MAX_NOTICE_BYTES = 7_900
"""Of one notification: PostgreSQL takes 8,000 bytes."""
MAX_LINE_BYTES = 3_500
MAX_POINTS = 60
POINT_S = 10.0
"""From one point of the speed to the next: ten minutes in all."""
_Name = Annotated[str, Meta(max_length=100)]
_Count = Annotated[int, Meta(ge=0, le=1_000_000)]
Counts = dict[AlarmPriority, _Count]
LineSpeed = Annotated[float, Meta(ge=-1e9, le=1e9)]


class CauseSummary(msgspec.Struct, frozen=True):
    """A cause that another server words for its readers; see :class:`app.live.diagnosis.cause.Cause`."""

    code: Annotated[str, Meta(max_length=60)]
    since: float | None = None
    is_exact: bool = True
    motion: Annotated[str, Meta(max_length=30)] = ""
    mode: Annotated[str, Meta(max_length=30)] = ""
    why: Message | None = None

    @classmethod
    def of(cls, cause: Cause) -> CauseSummary:
        params, onset = cause.params, cause.onset
        # In what a unit departs from its golden set is text; its page has it.
        why = Message("line_drifted") if cause.code == "drift" else params.get("why")
        return cls(
            cause.code,
            None if onset is None else float(onset.at),
            onset is None or onset.exact,
            params.get("motion", ""),
            params.get("mode", ""),
            why if isinstance(why, Message) else None,
        )

    def cause(self, level: Level) -> Cause:
        params = {"motion": self.motion, "mode": self.mode, "why": self.why}
        onset = None if self.since is None else Onset(UnixTime(self.since), exact=self.is_exact)
        return Cause(self.code, level, onset, {name: value for name, value in params.items() if value})


class EventSummary(msgspec.Struct, frozen=True):
    """The last event of a line. ``at``: Unix time in seconds."""

    at: float
    text: Message


class LineSummary(msgspec.Struct, frozen=True):
    """One line. ``verdict``: the text while there is no ``cause``; ``place``: the unit or bus of the
    cause. ``states``: units by state, and how many are ``online``; ``active`` and ``waiting`` (for an
    acknowledgement): alarms by priority; ``alarm``: the text of the first of them. ``speeds``: of the first
    unit, the newest last, in display units, None where none was read; ``scan_hz``: scans a second;
    ``recipe``: the one loaded last."""

    bus: _Name
    site: _Name
    server: _Name
    epoch: int
    level: Level
    verdict: Message
    units: _Count
    states: dict[Annotated[str, Meta(max_length=20)], _Count]
    active: Counts
    waiting: Counts
    place: Annotated[str, Meta(max_length=100)] = ""
    cause: CauseSummary | None = None
    alarm: Message | None = None
    alarm_priority: Level = ""
    scan_hz: float | None = None
    speeds: Annotated[list[LineSpeed | None], Meta(max_length=MAX_POINTS)] = []
    recipe: Message | None = None
    event: EventSummary | None = None


class Notice(msgspec.Struct, frozen=True):
    """Some lines of one server, each as it was sent: most are from one second to the next the same bytes,
    which are not read again. ``ends``: it stops, and will send no more."""

    server: _Name
    lines: Annotated[list[msgspec.Raw], Meta(max_length=500)]
    ends: bool = False


_encode = msgspec.json.Encoder().encode
_decoder = msgspec.json.Decoder(Notice)
_line_decoder = msgspec.json.Decoder(LineSummary)


def notices(server: str, lines: Iterable[LineSummary]) -> Iterator[str]:
    """The lines as texts of at most `MAX_NOTICE_BYTES` bytes."""
    head, tail = _encode(Notice(server, [])).split(b"[]")
    waiting: list[bytes] = []
    size = 0
    for line in lines:
        part = _within_bounds(line)
        if waiting and size + len(part) + len(head) + len(tail) + 2 > MAX_NOTICE_BYTES:
            yield (head + b"[" + b",".join(waiting) + b"]" + tail).decode()
            waiting, size = [], 0
        waiting.append(part)
        size += len(part) + 1
    if waiting:
        yield (head + b"[" + b",".join(waiting) + b"]" + tail).decode()


def end_notice(server: str) -> str:
    """That a server stops."""
    return _encode(Notice(server, [], ends=True)).decode()


def read_notice(text: str) -> Notice:
    """Raises ValueError for what no server of this version has sent."""
    try:
        return _decoder.decode(text)
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from error


def read_line(text: bytes) -> LineSummary:
    """One line of a notice. Raises ValueError as :func:`read_notice` does."""
    try:
        return _line_decoder.decode(text)
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from error


def _within_bounds(line: LineSummary) -> bytes:
    """A reason that a person typed may be long: it is on the page of the line."""
    part = _encode(line)
    if len(part) > MAX_LINE_BYTES:
        cause = line.cause and msgspec.structs.replace(line.cause, why=None)
        part = _encode(msgspec.structs.replace(line, cause=cause, alarm=None, event=None))
    return part

"""A line in short: its state, its alarms and its speed, never its readings. Pure."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from app.conditions.priority import AlarmPriority
from app.live.diagnosis.cause import Cause, Level
from app.live.state.onset import Onset
from bus.instants import UnixTime
from bus.messages import Message

MAX_POINTS = 60
POINT_S = 10.0
"""From one point of the speed to the next: ten minutes in all."""
_Name = Annotated[str, Meta(max_length=100)]
_Count = Annotated[int, Meta(ge=0, le=1_000_000)]
Counts = dict[AlarmPriority, _Count]
LineSpeed = Annotated[float, Meta(ge=-1e9, le=1e9)]


class CauseSummary(msgspec.Struct, frozen=True):
    """A cause that is put into words for each reader; see :class:`app.live.diagnosis.cause.Cause`."""

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

"""A line in short: its state, its alarms and its speed, never its readings. Pure: the time is passed in."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import islice

import msgspec

from app.line.alarms.alarm import Alarm
from app.line.alarms.line_alarms import rank
from app.line.conditions.condition import PRIORITIES, AlarmPriority
from app.line.live.bus_live import BusLive, figures_now, speed_decimals, unit_link_now
from app.line.live.diagnosis import (
    Cause,
    Level,
    UnitView,
    all_offline,
    bus_cause,
    shown_cause,
    state_counts,
    unit_cause,
)
from app.line.live.screen import LEVELS, all_well
from app.line.live.unit_status import Onset
from bus.instants import UnixTime
from bus.messages import Message

MAX_POINTS = 60
POINT_S = 10.0
"""From one point of the speed to the next: ten minutes in all."""
Counts = dict[AlarmPriority, int]


class CauseSummary(msgspec.Struct, frozen=True):
    """A cause that is put into words for each reader; see :class:`app.line.live.diagnosis.Cause`."""

    code: str
    since: float | None = None
    is_exact: bool = True
    motion: str = ""
    mode: str = ""
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
    unit, the newest last, in ``measure``, None where none was read; ``scan_hz``: scans a second;
    ``recipe``: the one loaded last."""

    bus: str
    site: str
    level: Level
    verdict: Message
    units: int
    states: dict[str, int]
    active: Counts
    waiting: Counts
    place: str = ""
    cause: CauseSummary | None = None
    alarm: Message | None = None
    alarm_priority: Level = ""
    scan_hz: float | None = None
    speeds: list[float | None] = []
    measure: str = ""
    recipe: Message | None = None
    event: EventSummary | None = None


@dataclass(slots=True)
class SpeedTrace:
    """The speed of the first unit of a line in the last ten minutes."""

    points: deque[float | None] = field(default_factory=lambda: deque(maxlen=MAX_POINTS))
    _next_at: UnixTime = UnixTime(0.0)

    def note(self, bus: BusLive, now: UnixTime) -> None:
        """Take a point when one is due; until the next it is that of the present. After a pause, what lies
        between is unknown."""
        speed = _line_speed(bus, now)
        if now < self._next_at:
            self.points[-1] = speed
            return
        missed = int((now - self._next_at) // POINT_S) if self.points else 0
        self.points.extend([None] * min(missed, MAX_POINTS))
        self.points.append(speed)
        self._next_at = now + POINT_S


def _line_speed(bus: BusLive, now: UnixTime) -> float | None:
    first = next(islice(bus.units.values(), 1), None)
    if first is None or first.reading is None or unit_link_now(bus, first, now) != "online":
        return None
    actual, decimals = first.reading.actual, speed_decimals(bus, first)
    return None if actual is None or decimals is None else float(Decimal(actual).scaleb(-decimals))


def summary_of(
    bus: BusLive,
    views: list[UnitView],
    alarms: Iterable[tuple[Alarm, Message]],
    speeds: Iterable[float | None],
    site: str,
    now: UnixTime,
) -> LineSummary:
    """Return a line in short. ``views``: how each unit looks; ``alarms``: those of the line that a person is
    to know of, each with its text; ``site``: its name."""
    place, cause = _worst(bus, views, now)
    counts = state_counts(views)
    known = sorted(alarms, key=lambda entry: rank(entry[0]))
    figures = figures_now(bus, now)
    first = known[0] if known else None
    return LineSummary(
        bus.settings.name,
        site,
        cause.level if cause else "",
        all_well(len(views), counts),
        len(views),
        dict(counts),
        _by_priority(alarm for alarm, _ in known if alarm.facts.active),
        _by_priority(alarm for alarm, _ in known if alarm.is_unacknowledged),
        place=place,
        cause=CauseSummary.of(cause) if cause else None,
        alarm=first[1] if first else None,
        alarm_priority=first[0].definition.priority if first else "",
        scan_hz=None if figures is None else figures.scan_hz,
        speeds=list(speeds),
        measure=next((unit.settings.labels.unit for unit in bus.units.values()), ""),
    )


def view_of(bus: BusLive, number: int, blocked: Message | None, drifted: str, now: UnixTime) -> UnitView:
    """Return how a unit looks on a tile of its line."""
    unit = bus.units[number]
    cause = shown_cause(bus, unit, unit_cause(bus, unit, now), now, blocked=blocked, drifted=drifted)
    return UnitView(unit, unit_link_now(bus, unit, now), cause)


def _worst(bus: BusLive, views: list[UnitView], now: UnixTime) -> tuple[str, Cause | None]:
    """Return what the verdict names: a cause of the bus, else that of the first unit of the highest
    priority."""
    of_bus = bus_cause(bus, now) or all_offline(bus, now)
    if of_bus is not None:
        return bus.settings.name, of_bus
    found = [(view.unit.settings.name, view.cause) for view in views if view.cause and view.level]
    if not found:
        return "", None
    return min(found, key=lambda entry: LEVELS.index(entry[1].level))


def _by_priority(alarms: Iterable[Alarm]) -> Counts:
    counted = Counter(alarm.definition.priority for alarm in alarms)
    return {priority: counted[priority] for priority in PRIORITIES if counted[priority]}

"""Summaries of lines: state, alarms and speed without the readings; and those of this server's lines."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import islice
from math import ceil

import msgspec
from msgspec.structs import replace

from app.errors import StoreError
from app.line.alarms.alarm import Alarm
from app.line.alarms.line_alarms import LineAlarms, rank
from app.line.conditions.catalogue import TILES
from app.line.conditions.condition import PRIORITIES, AlarmPriority
from app.line.live.bus_live import BusLive, LiveState, Onset, figures_now, speed_decimals, unit_link_now
from app.line.live.diagnosis import (
    Cause,
    Level,
    UnitView,
    are_alike,
    no_response_cause,
    shown_cause,
    state_counts,
    timed_as_alarm,
    unit_cause,
)
from app.line.live.fields import Translator, unit_key
from app.line.live.screen import LEVELS, all_well
from app.line.live.sources import AlarmDelay, AlarmSince, Sources, no_alarm, no_delay
from app.people.audit.entry import EventKind
from app.people.audit.log import Event, EventLog, Filter, Logged
from bus.instants import Monotonic, UnixTime, monotonic_now, unix_now
from bus.messages import Message, ParamValue, term

MAX_POINTS = 60
POINT_S = 10.0
"""The seconds between two points of the speed: ten minutes in all."""
Counts = dict[AlarmPriority, int]


class CauseSummary(msgspec.Struct, frozen=True):
    """A cause in a form that is put into words for each reader (:class:`app.line.live.diagnosis.Cause`).
    ``alarm_in_s``: after how many seconds it becomes an alarm; 0 if it is one, or becomes none."""

    code: str
    since: float | None = None
    is_exact: bool = True
    motion: str = ""
    mode: str = ""
    why: Message | None = None
    alarm_in_s: int = 0

    @classmethod
    def from_cause(cls, cause: Cause, alarm_in_s: float = 0.0) -> CauseSummary:
        params, onset = cause.params, cause.onset
        why = params.get("why")
        return cls(
            cause.code,
            None if onset is None else float(onset.at),
            onset is None or onset.exact,
            params.get("motion", ""),
            params.get("mode", ""),
            why if isinstance(why, Message) else None,
            ceil(alarm_in_s),
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
    """The summary of one line. ``verdict``: the text if there is no ``cause``; ``place``: the unit or bus of
    the cause; ``alike``: how many units it is the cause of, since the same minute. ``states``: units by
    state, and the number that is ``online``; ``active`` and ``waiting`` (for an acknowledgement): alarms by
    priority; ``unknown``: the number that were active and may have ended since; ``alarm``: the text of the
    first alarm. ``abnormal``: the names of the units that are abnormal, the worst first, of a line of this
    server. ``speeds``: of the first unit, the newest last, in ``measure`` with its ``decimals`` (None from a
    server that does not tell them), None if not read; ``scan_hz``: scans a second; ``recipe``: the one last
    loaded."""

    bus: str
    site: str
    level: Level
    verdict: Message
    units: int
    states: dict[str, int]
    active: Counts
    waiting: Counts
    unknown: int = 0
    place: str = ""
    alike: int = 1
    abnormal: list[str] = []
    cause: CauseSummary | None = None
    alarm: Message | None = None
    alarm_priority: Level = ""
    scan_hz: float | None = None
    speeds: list[float | None] = []
    measure: str = ""
    decimals: int | None = None
    recipe: Message | None = None
    event: EventSummary | None = None


@dataclass(slots=True)
class SpeedTrace:
    """The speed of the first unit of a line in the last ten minutes."""

    points: deque[float | None] = field(default_factory=lambda: deque(maxlen=MAX_POINTS))
    _next_at: UnixTime = UnixTime(0.0)

    def note(self, bus: BusLive, now: UnixTime) -> None:
        """Take a point when one is due; until the next, it is the present speed. After a pause, the points in
        between are unknown."""
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
    alarm_delay_s: AlarmDelay = no_delay,
    unknown: int = 0,
) -> LineSummary:
    """Return the summary of a line. ``views``: of each unit; ``alarms``: those of the line for people, each
    with its text; ``site``: its name; ``alarm_delay_s``: when a condition becomes an alarm; ``unknown``: how
    many alarms may have ended."""
    place, key, cause = _worst(bus, views, now)
    counts = state_counts(views)
    known = sorted(alarms, key=lambda entry: rank(entry[0]))
    figures = figures_now(bus, now)
    first = known[0] if known else None
    return LineSummary(
        bus.settings.name,
        site,
        cause.level if cause else "",
        all_well(len(views), counts, None),
        len(views),
        dict(counts),
        _by_priority(alarm for alarm, _ in known if alarm.facts.active and not alarm.is_unknown),
        _by_priority(alarm for alarm, _ in known if alarm.is_unacknowledged),
        unknown,
        place=place,
        abnormal=[
            view.unit.settings.name
            for view in sorted(views, key=lambda view: LEVELS.index(view.level))
            if view.level not in ("", "low")
        ],
        alike=sum(are_alike(cause, view.cause) for view in views) or 1,
        cause=CauseSummary.from_cause(cause, alarm_delay_s(key, TILES[cause.code].code)) if cause else None,
        alarm=first[1] if first else None,
        alarm_priority=first[0].definition.priority if first else "",
        scan_hz=None if figures is None else figures.scan_hz,
        speeds=list(speeds),
        measure=next((unit.settings.labels.unit for unit in bus.units.values()), ""),
        decimals=next((speed_decimals(bus, unit) for unit in bus.units.values()), None),
    )


def view_of(
    bus: BusLive,
    number: int,
    blocked: Message | None,
    drifted: str,
    now: UnixTime,
    alarm_since: AlarmSince = no_alarm,
) -> UnitView:
    """Return the view of a unit for a tile of its line."""
    unit = bus.units[number]
    cause = shown_cause(bus, unit, unit_cause(bus, unit, now), now, blocked=blocked, drifted=drifted)
    cause = timed_as_alarm(cause, unit_key(bus.settings.name, number), alarm_since)
    return UnitView(unit, unit_link_now(bus, unit, now), cause)


def _worst(bus: BusLive, views: list[UnitView], now: UnixTime) -> tuple[str, str, Cause | None]:
    """Return the cause for the verdict, after name and key of what it is of: the bus, else the first unit of
    the highest priority. A condition of low priority is not a verdict on a line."""
    name, of_bus = bus.settings.name, no_response_cause(bus, now)
    if of_bus is not None:
        return name, name, of_bus
    worst = min(views, key=lambda view: LEVELS.index(view.level), default=None)
    if worst is None or worst.level in ("", "low"):
        return "", "", None
    return worst.unit.settings.name, unit_key(name, worst.unit.settings.id), worst.cause


def _by_priority(alarms: Iterable[Alarm]) -> Counts:
    counted = Counter(alarm.definition.priority for alarm in alarms)
    return {priority: counted[priority] for priority in PRIORITIES if counted[priority]}


READ_EVERY_S = 1.0
READ = (1, 10)
"""How many of the newest events of a line are read: one, as the last is mostly that of a command, and ten if
it is of a kind that is not shown."""
SHOWN: frozenset[EventKind] = frozenset(
    ("block", "bus", "command", "estop", "mode", "recipe", "restore", "run", "swap", "unit", "worker")
)
"""The kinds of events that say what a line, its port or its worker did, unlike a sign-in or a note."""
DONE = ("verified", "acknowledged")
OF_SEVERAL = ("event_set_line", "event_zero_line", "event_execute_all")
FRESH_S = 0.9
"""The age up to which a summary serves another reader."""
TRACE_S = 1.0


@dataclass(eq=False, repr=False)
class LastEvents:
    """The last event of each line, read from the event log if a line has a new one and is shown."""

    live: LiveState
    events: EventLog
    _last: dict[str, EventSummary] = field(default_factory=dict)
    _changed: set[str] = field(default_factory=set)
    _wanted: asyncio.Event = field(default_factory=asyncio.Event)

    def __post_init__(self) -> None:
        self._changed |= set(self.live.buses)
        self.events.subscribe(self._note)

    def newest_of(self, bus: str) -> EventSummary | None:
        """Return the last event of a line, None if there is none yet."""
        self._wanted.set()
        return self._last.get(bus)

    def _note(self, event: Logged) -> None:
        if event.bus in self.live.buses:
            self._changed.add(event.bus)

    async def follow(self) -> None:
        """Read new events until canceled. While the log cannot be read, the known events stay."""
        while True:
            await self._wanted.wait()
            self._wanted.clear()
            await self.read()
            await asyncio.sleep(READ_EVERY_S)

    async def read(self) -> None:
        """Read the last event of each line that has a new one. A change of several units is one event."""
        for bus in sorted(self._changed):
            with suppress(StoreError):
                last = await self._last_shown(bus)
                self._changed.discard(bus)
                if last is not None and last["time"]:
                    self._last[bus] = EventSummary(float(last["time"]), self._text(last))

    async def _last_shown(self, bus: str) -> Event | None:
        for count in READ:
            found, _ = await self.events.page(Filter(bus=bus, folded=True), count)
            last = next((event for event in found if _is_shown(event)), None)
            if last is not None:
                return last
        return None

    def _text(self, event: Event) -> Message:
        """Return the text of an event, such as ``Dryer 2 · speed set: 120.0 → 121.0``, with the result if the
        command was not carried out. Of a command to several units it names the person, and no values."""
        unit = self.live.buses[event["bus"]].units.get(event["unit"] or 0)
        what, old, new = _field(event, "what"), _field(event, "old"), _field(event, "new")
        if isinstance(what, Message) and what.code in OF_SEVERAL:
            text = Message.of("line_event_by", what=what, who=_field(event, "who"))
        elif old and new:
            text = Message.of("line_event_change", what=what, old=old, new=new)
        else:
            text = Message.of("line_event", what=what)
        if event["outcome"] not in (None, *DONE):
            text = Message.of("line_event_outcome", event=text, outcome=term(event["outcome"]))
        if unit is None:
            return text
        return Message.of("line_event_at", name=unit.settings.name, event=text)


def _is_shown(event: Event) -> bool:
    what = _field(event, "what")
    is_late = isinstance(what, Message) and what.code == "event_readings_late"
    return event["kind"] in SHOWN and not is_late


def _field(event: Event, name: str) -> ParamValue:
    found: ParamValue = event["messages"].get(name) or event[name] or ""
    return found


@dataclass(eq=False, repr=False)
class OwnLines:
    """The summaries of this server's lines. ``site``: its name; ``english``: for texts only compared."""

    site: str
    live: LiveState
    alarms: LineAlarms
    sources: Sources
    events: LastEvents
    english: Translator
    _traces: dict[str, SpeedTrace] = field(default_factory=dict)
    _made: list[LineSummary] = field(default_factory=list)
    _made_at: Monotonic = Monotonic(float("-inf"))

    def summaries(self) -> list[LineSummary]:
        """Return the summary of each line, less than a second old."""
        now = monotonic_now()
        if now - self._made_at > FRESH_S:
            self._made = [self._summary(bus) for bus in self.live.buses]
            self._made_at = now
        return self._made

    async def trace(self) -> None:
        """Take the points of the speeds until canceled."""
        while True:
            self.note_speeds()
            await asyncio.sleep(TRACE_S)

    def note_speeds(self) -> None:
        """Take a point for each line if one is due."""
        now = unix_now()
        for name, bus in self.live.buses.items():
            self._traces.setdefault(name, SpeedTrace()).note(bus, now)

    def _summary(self, name: str) -> LineSummary:
        bus, now = self.live.buses[name], unix_now()
        guards, drift = self.sources.guards[name], self.sources.drift[name]
        views = [
            view_of(
                bus,
                number,
                guards.block_reason(number),
                drift.summary(number, self.english, now).words,
                now,
                self.sources.alarm_since,
            )
            for number in bus.units
        ]
        trace = self._traces.setdefault(name, SpeedTrace())
        trace.note(bus, now)
        delay_s = self.sources.alarm_delay_s
        unknown = sum(alarm.definition.bus == name for alarm in self.alarms.unknown())
        alarms = self._alarms_of(name)
        found = summary_of(bus, views, alarms, trace.points, self.site, now, delay_s, unknown)
        return replace(found, recipe=self._recipe(name), event=self.events.newest_of(name))

    def _recipe(self, bus: str) -> Message | None:
        loaded = self.sources.recipes[bus]()
        if loaded is None:
            return None
        name, departed = loaded
        if not departed:
            return Message.of("line_recipe", name=name)
        return Message.of("recipe_with_drift_of_many", name=name, n=len(departed))

    def _alarms_of(self, bus: str) -> Iterator[tuple[Alarm, Message]]:
        for alarm in self.alarms.annunciated():
            definition = alarm.definition
            if definition.bus == bus:
                place = self.alarms.buses[bus].place(definition.unit)
                yield alarm, Message.of("line_alarm_at", place=place, name=definition.name)

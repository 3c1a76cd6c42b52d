"""The summaries of the lines of this server, each with its last event."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from msgspec.structs import replace

from app.errors import StoreError
from app.line.alarms.alarm import Alarm
from app.line.alarms.line_alarms import LineAlarms
from app.line.live.bus_live import LiveState
from app.line.live.fields import Translator
from app.line.live.sources import GoldenDrift, LoadedRecipes, UnitGuards
from app.people.audit.entry import EventKind
from app.people.audit.log import Event, EventLog
from app.people.audit.queries import Filter
from app.system.peers.summary import EventSummary, LineSummary, SpeedTrace, summary_of, view_of
from bus.instants import Clock, Monotonic, MonotonicClock, monotonic_now, unix_now
from bus.messages import Message, ParamValue, term

READ_EVERY_S = 1.0
MAX_READ = 10
"""Events of a line that are read: the last of a shown kind is nearly always among them."""
SHOWN: frozenset[EventKind] = frozenset(
    ("block", "bus", "command", "estop", "mode", "recipe", "restore", "run", "swap", "unit", "worker")
)
"""The kinds that explain what a line does; control, sign-ins and notes do not."""
LATE = "event_readings_late"
"""At each start of the server: its worker begins before it."""
DONE = ("verified", "acknowledged")
FRESH_S = 0.9
"""A summary of this age serves another reader."""
TRACE_S = 1.0


@dataclass(eq=False, repr=False)
class LastEvents:
    """Reads the event log where a line has a new event."""

    live: LiveState
    events: EventLog
    _last: dict[str, EventSummary] = field(default_factory=dict)
    _changed: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._changed |= set(self.live.buses)
        self.events.subscribe(self._note)

    def of(self, bus: str) -> EventSummary | None:
        """Return the last event of a line, None where there is none yet."""
        return self._last.get(bus)

    def _note(self, event: Event) -> None:
        if event["bus"] in self.live.buses:
            self._changed.add(event["bus"])

    async def follow(self) -> None:
        """Run until canceled: read what was logged. While the log cannot be read, the known ones stay."""
        while True:
            await self.read()
            await asyncio.sleep(READ_EVERY_S)

    async def read(self) -> None:
        """Read the last event of each line that has a new one. A change of several units is one."""
        for bus in sorted(self._changed):
            with suppress(StoreError):
                found, _ = await self.events.page(Filter(bus=bus, folded=True), MAX_READ)
                self._changed.discard(bus)
                last = next((event for event in found if _is_shown(event)), None)
                if last is not None and last["time"]:
                    self._last[bus] = EventSummary(float(last["time"]), self._text(last))

    def _text(self, event: Event) -> Message:
        """Return the text of an event, such as ``Dryer 2 · speed set: 120.0 → 121.0``, with the result where
        the command was not carried out."""
        unit = self.live.buses[event["bus"]].units.get(event["unit"] or 0)
        old, new = _field(event, "old"), _field(event, "new")
        if old and new:
            text = Message.of("line_event_change", what=_field(event, "what"), old=old, new=new)
        else:
            text = Message.of("line_event", what=_field(event, "what"))
        if event["outcome"] not in (None, *DONE):
            text = Message.of("line_event_outcome", event=text, outcome=term(event["outcome"]))
        if unit is None:
            return text
        return Message.of("line_event_at", name=unit.settings.name, event=text)


def _is_shown(event: Event) -> bool:
    what = _field(event, "what")
    return event["kind"] in SHOWN and not (isinstance(what, Message) and what.code == LATE)


def _field(event: Event, name: str) -> ParamValue:
    found: ParamValue = event["messages"].get(name) or event[name] or ""
    return found


@dataclass(eq=False, repr=False)
class OwnLines:
    """``site``: its name. ``english``: for what only has to be known to differ."""

    site: str
    live: LiveState
    alarms: LineAlarms
    guards: Mapping[str, UnitGuards]
    drift: Mapping[str, GoldenDrift]
    recipes: LoadedRecipes
    events: LastEvents
    english: Translator
    clock: Clock = unix_now
    monotonic: MonotonicClock = monotonic_now
    _traces: dict[str, SpeedTrace] = field(default_factory=dict)
    _made: list[LineSummary] = field(default_factory=list)
    _made_at: Monotonic = Monotonic(float("-inf"))

    def summaries(self) -> list[LineSummary]:
        """Return the summary of each line, less than a second old."""
        now = self.monotonic()
        if now - self._made_at > FRESH_S:
            self._made = [self._summary(bus) for bus in self.live.buses]
            self._made_at = now
        return self._made

    async def trace(self) -> None:
        """Run until canceled: take the points of the speeds."""
        while True:
            self.note_speeds()
            await asyncio.sleep(TRACE_S)

    def note_speeds(self) -> None:
        """Take a point of each line where one is due."""
        now = self.clock()
        for name, bus in self.live.buses.items():
            self._traces.setdefault(name, SpeedTrace()).note(bus, now)

    def _summary(self, name: str) -> LineSummary:
        bus, now = self.live.buses[name], self.clock()
        guards, drift = self.guards[name], self.drift[name]
        views = [
            view_of(
                bus,
                number,
                guards.block_reason(number),
                drift.summary(number, self.english, now).words,
                now,
            )
            for number in bus.units
        ]
        trace = self._traces.setdefault(name, SpeedTrace())
        trace.note(bus, now)
        found = summary_of(bus, views, self._alarms_of(name), trace.points, self.site, now)
        return replace(found, recipe=self._recipe(name), event=self.events.of(name))

    def _recipe(self, bus: str) -> Message | None:
        loaded = self.recipes.loaded_words(bus)
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

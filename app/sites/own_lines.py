"""The summaries of the lines of this server."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from msgspec.structs import replace

from app.alarms.alarm import Alarm
from app.alarms.monitor.line_alarms import LineAlarms
from app.live.screen.fields import Translator
from app.live.screen.sources import GoldenDrift, LoadedRecipes, UnitGuards
from app.live.state.bus_live import LiveState
from app.sites.last_events import LastEvents
from app.sites.summarize import SpeedTrace, summary_of, view_of
from app.sites.summary import LineSummary
from bus.instants import Clock, Monotonic, MonotonicClock, monotonic_now, unix_now
from bus.messages import Message

FRESH_S = 0.9
"""A summary of this age serves another reader."""
TRACE_S = 1.0


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

"""The past of a demo: a day of its simulated line, written into its stores."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import groupby, pairwise
from typing import Literal, NamedTuple
from zoneinfo import ZoneInfo

from app.core.database import Database, StoreConnection
from app.core.web.access import Person, Role
from app.engineering.recipes import book
from app.engineering.recipes.book import RecipeStore
from app.engineering.recipes.rules import Recipe, RecipeSetpoint
from app.engineering.sets import saving
from app.engineering.sets.model import ParameterRow, ParameterSet, UnitRows
from app.engineering.sets.store import SetStore
from app.line.alarms.acts import ACKNOWLEDGE
from app.line.alarms.alarm import Alarm, AlarmDefinition, built_in
from app.line.alarms.journal import AlarmStore, entry_of
from app.line.alarms.performance import ObservedSpan
from app.line.alarms.rules import AlarmAttributes, AlarmFacts, Changed, acknowledge, observe
from app.line.conditions.catalogue import CONDITIONS
from app.line.history import recorder, tables
from app.line.history.series.runs import DAY, HOUR, MINUTE, SECOND, PlainRun, combine, micros, minute_rollups
from app.line.history.series.values import DECIDING, Marks, ParameterStep, intervals
from app.line.history.service import FILE
from app.line.history.writer import MIGRATIONS
from app.people.audit.acts import Act
from app.people.audit.keys import open_keys
from app.people.audit.log import EventLog
from app.people.audit.proof import heads_of
from app.records.handover import notes
from app.records.handover.notes import Note
from app.records.handover.rules import shift_at, site_time
from app.records.handover.signatures import WRITE_NOTE
from app.settings import Settings
from bus.catalogue import parameters as numbers
from bus.catalogue.parameters import PARAMETERS
from bus.instants import DAY_S, HOUR_S, UnixTime, unix_now
from bus.messages import Message, term
from bus.simulator.plant import TENSION_AT_REST, TENSION_RUNNING, DemoLine
from bus.simulator.unit import Unit

MAX_UNITS = 8
"""The number of units with readings: a longer line would take seconds to write."""
GAP_S = 5.0
"""The seconds between the last reading of the past and the first of the demo."""


_ESTOPPED, _AT_SPEED = 0x4001, 0xC003
"""ST2 * 256 + ST1: in REMOTE with run; at speed, or with the e-stop input active."""
_UNREST = 2
"""The largest difference of the speed from its setpoint, in display units."""
OPERATOR, ENGINEER = (Person(f"demo-{role.value}", role, "demo") for role in (Role.OPERATOR, Role.ENGINEER))
GOLDEN_HOURS_AGO, DRIFTED = 20.0, 3
"""The set is older than a ramp change of this unit, made at its keypad."""
DRIFT_TENTHS = 30
NOTED_AFTER_S = 360.0
MAX_GOLDEN = 16
"""The number of units with a golden set: each is read completely soon after the start."""
_CHANGED_HOURS_AGO, _CHANGED = 13.3, "Simulated: changed from primer 90 to coating 120."
_Record = tuple[UnixTime, Callable[[], Awaitable[None]]]


class Phase(NamedTuple):
    """A part of the day in which the line ran at a ``share`` of its setpoints."""

    hours_ago: float
    share: float


PHASES = (Phase(24.0, 0.75), Phase(13.6, 0.0), Phase(13.2, 1.0))
"""Primer, a change of recipe at standstill, and the present speed."""


@dataclass(frozen=True, slots=True)
class Incident:
    """An event that stopped a unit or its link, acknowledged after so many seconds or never; ``note``: the
    text of the operator."""

    code: Literal["estop_active", "unit_offline"]
    unit: int
    began: UnixTime
    lasted_s: float
    acknowledged_after_s: float | None
    note: str

    @property
    def ended(self) -> UnixTime:
        return self.began + self.lasted_s

    @property
    def acknowledged_at(self) -> UnixTime | None:
        after_s = self.acknowledged_after_s
        return None if after_s is None else self.began + after_s

    def holds(self, at: UnixTime) -> bool:
        return self.began <= at < self.ended


_INCIDENTS: tuple[
    tuple[Literal["estop_active", "unit_offline"], int, float, float, float | None, str], ...
] = (
    (
        "estop_active",
        3,
        19.3,
        240.0,
        42.0,
        "Web break at the coater, threaded again. Blade checked, no damage.",
    ),
    ("estop_active", 1, 16.8, 35.0, 20.0, "Splice at the unwind."),
    ("unit_offline", 5, 9.1, 130.0, 75.0, "Dryer 2 did not respond for two minutes, connector tightened."),
    ("estop_active", 8, 6.4, 95.0, 30.0, "Roll change at the rewind."),
    ("estop_active", 3, 5.7, 60.0, 25.0, "Blade of the coater cleaned."),
    ("unit_offline", 2, 2.6, 48.0, 90.0, "Infeed nip did not respond for 48 seconds, cable to be looked at."),
    ("estop_active", 4, 0.7, 50.0, None, "Emergency stop at dryer 1 is still to be explained."),
)
"""The incidents of a day. History, alarms, events and notes agree on each one's unit and time."""


class Stretch(NamedTuple):
    """A time in which nothing about a unit changed, with the share of its setpoint at which it ran, and the
    incident that stopped it."""

    begins: UnixTime
    ends: UnixTime
    share: float
    incident: Incident | None


@dataclass(frozen=True, slots=True)
class Past:
    """The day before ``now``."""

    now: UnixTime
    units: tuple[Unit, ...]
    names: tuple[str, ...]
    incidents: tuple[Incident, ...]

    @property
    def begins(self) -> UnixTime:
        return self.now - DAY_S

    def hours_ago(self, hours: float) -> UnixTime:
        return self.now - hours * HOUR_S

    def stretches(self, unit: int) -> Iterator[Stretch]:
        """Yield the stretches of a unit's day, in order."""
        ends = self.now - GAP_S
        phases = [(self.hours_ago(phase.hours_ago), phase.share) for phase in PHASES]
        incidents = [each for each in self.incidents if each.unit == unit]
        edges = {at for at, _ in phases} | {at for each in incidents for at in (each.began, each.ended)}
        times = [*sorted(edges), ends]
        for begin, end in pairwise(times):
            share = [share for at, share in phases if at <= begin][-1]
            yield Stretch(begin, end, share, next((each for each in incidents if each.holds(begin)), None))


def past_of(line: DemoLine, now: UnixTime) -> Past:
    """Return the past of a line, without incidents of units that it does not have."""
    incidents = (
        Incident(code, unit, now - hours * HOUR_S, lasted, acknowledged, f"Simulated: {note}")
        for code, unit, hours, lasted, acknowledged, note in _INCIDENTS
        if unit <= len(line.settings)
    )
    return Past(now, tuple(line.plant.units), tuple(unit.name for unit in line.settings), tuple(incidents))


def _setpoint_of(unit: Unit, share: float) -> int:
    """Return a unit's setpoint while the line runs at this share; the ratio of a follower stays."""
    return unit.setpoint if unit.follows else round(unit.memory[numbers.SPEED_SETPOINT] * share)


def write_past(settings: Settings, line: DemoLine) -> None:
    """Write a day of history, alarms, events, recipes, sets and notes before the dashboard opens its stores.
    Raise StoreError."""
    past = past_of(line, unix_now())
    with closing(Database(settings.server.data / FILE, MIGRATIONS, "NORMAL")) as history:
        history.write_now(lambda connection: _write_readings(connection, settings.bus[0].name, past))
    with closing(Database(settings.server.store, synchronous="NORMAL")) as store:
        asyncio.run(_Records(settings, store, past).write())


def _write_readings(connection: StoreConnection, bus: str, past: Past) -> None:
    for address, unit in enumerate(past.units[:MAX_UNITS], start=1):
        key, stretches = tables.unit_id(connection, bus, address), list(past.stretches(address))
        begins = micros(past.begins)
        for number in DECIDING:
            tables.write_parameter(connection, key, ParameterStep(begins, number, unit.memory[number]))
        for at, state in _links(stretches):
            tables.write_link(connection, key, at, state, "")
        runs = list(_runs(unit, stretches, random.Random(address)))
        _write_blocks(connection, key, runs, _marks(stretches))


def _links(stretches: list[Stretch]) -> list[tuple[int, str]]:
    """Return the times at which the unit changed its link state, with the state."""
    states = [(micros(each.begins), "online" if _is_online(each) else "offline") for each in stretches]
    return [next(of) for _, of in groupby(states, key=lambda each: each[1])]


def _marks(stretches: list[Stretch]) -> Marks:
    links = _links(stretches)
    lost = [at for at, state in links if state == "offline"]
    return Marks(lost, [at for at, state in links if state == "online"])


def _write_blocks(connection: StoreConnection, key: int, runs: list[PlainRun], marks: Marks) -> None:
    of_day: dict[int, list[tuple[int, list[PlainRun]]]] = {}
    for hour, of in groupby(runs, key=lambda run: run[0] - run[0] % HOUR):
        of_day.setdefault(hour - hour % DAY, []).append((hour, list(of)))
    for day, hours in of_day.items():
        rollups = []
        for hour, rows_of_hour in hours:
            table = list(zip(*rows_of_hour, strict=True))
            tables.write_raw(connection, key, hour, HOUR, table)
            rows = minute_rollups(table)
            tables.write_rollups(connection, "minutes", key, hour, rows)
            rollups.append(combine(rows, hour))
        tables.write_rollups(connection, "hours", key, day, rollups)
    bits = intervals(((run[0], run[1], run[6]) for run in runs), marks, MINUTE)
    recorder.replace_bits(connection, {key: ()}, {key: bits})


def _is_online(stretch: Stretch) -> bool:
    return stretch.incident is None or stretch.incident.code != "unit_offline"


def _runs(unit: Unit, stretches: list[Stretch], noise: random.Random) -> Iterator[PlainRun]:
    """Yield one run a minute, and another when a value changes."""
    for stretch in filter(_is_online, stretches):
        commanded = _setpoint_of(unit, stretch.share)
        at, ends = micros(stretch.begins), micros(stretch.ends)
        while at < ends:
            until = min(at - at % MINUTE + MINUTE, ends)
            seconds = (until - at) // SECOND
            if seconds:
                values = _values(commanded, stretch, noise)
                yield at, at + (seconds - 1) * SECOND, seconds, commanded, *values
            at = until


def _values(commanded: int, stretch: Stretch, noise: random.Random) -> tuple[int, int, int]:
    """Return actual speed, analog input and bits."""
    word = _AT_SPEED if stretch.incident is None else _ESTOPPED
    if stretch.incident is None and stretch.share:
        return (
            commanded + noise.randint(-_UNREST, _UNREST),
            round(TENSION_RUNNING) + noise.randint(-3, 3),
            word,
        )
    return 0, round(TENSION_AT_REST) + noise.randint(-1, 1), word


class _Records:
    """The records of the past, each written at its time."""

    def __init__(self, settings: Settings, database: Database, past: Past) -> None:
        self._past, self._database, self._bus = past, database, settings.bus[0].name
        self._now = past.begins
        keys = open_keys(settings.key_files, database.path, database.read_now(heads_of))
        self._events = EventLog(database, lambda: self._now, keys)
        self._alarms = AlarmStore(database)
        self._recipes, self._sets = RecipeStore(database), SetStore(database)
        self._zone, self._shifts = ZoneInfo(settings.site.zone), settings.shift.minutes
        self._facts: dict[str, AlarmFacts] = {}

    async def write(self) -> None:
        for at, step in sorted(self._steps(), key=lambda step: float(step[0])):
            self._now = at
            await step()
        await self._alarms.write_observed(self._bus, ObservedSpan(self._past.begins, self._past.now))

    def _steps(self) -> Iterator[_Record]:
        ago = self._past.hours_ago
        yield ago(23.8), partial(self._recipe, "Primer 90", 0.75, loaded=True)
        yield ago(22.5), partial(self._recipe, "Coating 120", 1.0, loaded=False)
        yield ago(13.2), partial(self._recipe, "Coating 120", 1.0, loaded=True)
        yield ago(GOLDEN_HOURS_AGO), self._golden_set
        changed = ago(_CHANGED_HOURS_AGO)
        yield changed, partial(self._note, None, _CHANGED, changed)
        for incident in self._past.incidents:
            yield from self._changes(incident)
        yield self._past.now - GAP_S, self._ended

    def _changes(self, incident: Incident) -> Iterator[_Record]:
        """Yield the beginning and the end of an incident, and the acknowledgement of its alarm."""
        alarm = built_in(incident.code, self._bus, incident.unit)
        yield incident.began, partial(self._changed, incident, alarm, partial(observe, holds=True))
        yield incident.ended, partial(self._changed, incident, alarm, partial(observe, holds=False))
        written = incident.began + NOTED_AFTER_S
        yield written, partial(self._note, incident.unit, incident.note, incident.began)
        if incident.acknowledged_at is not None:
            yield incident.acknowledged_at, partial(self._changed, incident, alarm, acknowledge)

    async def _changed(
        self, incident: Incident, alarm: AlarmDefinition, change: Callable[..., Changed]
    ) -> None:
        """Change the alarm by the rules of real alarms, and record that with its event."""
        former = self._facts.get(alarm.key, AlarmFacts())
        facts, done = change(former, AlarmAttributes(), at=self._now)
        self._facts[alarm.key] = facts
        if facts.active != former.active:
            await self._line_event(incident, holds=facts.active)
            who = ""
        else:
            who = OPERATOR.name
            act = ACKNOWLEDGE.by(OPERATOR, name=alarm.name)
            await self._events.record(**act, bus=self._bus, unit=incident.unit)
        await self._alarms.write([entry_of(alarm, each, who) for each in done], [Alarm(alarm, facts)])

    async def _ended(self) -> None:
        """Record that the server of the past ended, so that no sheet takes the time since its last incident
        for one without a record."""
        await self._events.record(kind="server", what=Message("event_server_ended"))

    async def _line_event(self, incident: Incident, *, holds: bool) -> None:
        event = CONDITIONS[incident.code].event
        assert event is not None
        what = Message(event.began if holds else event.ended)
        old, new = (event.off, event.on) if holds else (event.on, event.off)
        await self._events.record(
            kind=event.kind, bus=self._bus, unit=incident.unit, what=what, old=old, new=new
        )

    async def _recipe(self, name: str, share: float, *, loaded: bool) -> None:
        known = [each for each in await self._recipes.newest(self._bus) if each.name == name]
        setpoints = tuple(
            RecipeSetpoint(address, _setpoint_of(unit, share), "ratio" if unit.follows else "speed")
            for address, unit in enumerate(self._past.units, start=1)
        )
        if known:
            recipe = known[0]
        else:
            recipe = Recipe(self._bus, name, "simulated", ENGINEER.name, self._now, setpoints)
            recipe = await self._recipes.save(recipe)
            await self._record_recipe(book.SAVE, ENGINEER, recipe)
        if loaded:
            await self._recipes.mark_loaded(self._bus, recipe.id, OPERATOR.name, self._now)
            await self._record_recipe(book.LOAD, OPERATOR, recipe)

    async def _record_recipe(self, act: Act, person: Person, recipe: Recipe) -> None:
        performed = act.by(person, name=recipe.name, version=recipe.version)
        await self._events.record(**performed, bus=self._bus)

    async def _golden_set(self) -> None:
        rows = tuple(
            UnitRows(address, name, self._parameters(address))
            for address, name in enumerate(self._past.names, start=1)
        )
        kept = await self._sets.save(
            ParameterSet(self._bus, self._now, ENGINEER.name, "by hand", rows, "Commissioned", "simulated")
        )
        units = [each.unit for each in rows]
        saved = saving.SAVE.by(ENGINEER, set=kept.id, units=[*units], origin=term(kept.origin))
        await self._events.record(**saved, bus=self._bus)
        golden = units[:MAX_GOLDEN]
        await self._sets.mark_golden(self._bus, golden, kept.id, ENGINEER.name, self._now)
        for unit in golden:
            await self._events.record(
                **saving.MARK_GOLDEN.by(ENGINEER, set=kept.id, unit=unit), bus=self._bus, unit=unit
            )

    def _parameters(self, address: int) -> dict[int, ParameterRow]:
        """Return the unit's present parameters, but without its drift and without the operator password."""
        memory = self._past.units[address - 1].memory
        raws = {number: None if row.secret else memory[number] for number, row in PARAMETERS.items()}
        if address == min(DRIFTED, len(self._past.units)):
            raws[numbers.ACCELERATION] = memory[numbers.ACCELERATION] - DRIFT_TENTHS
        return {number: ParameterRow(number, raw, read_at=self._now) for number, raw in raws.items()}

    async def _note(self, unit: int | None, text: str, about: UnixTime) -> None:
        """Write a note into the shift of the time that it is about."""
        shift = shift_at(about, self._shifts, self._zone)
        note = Note(
            at=about,
            written_at=self._now,
            who=OPERATOR.name,
            text=text,
            bus=self._bus,
            unit=unit,
            alarm=None,
            corrects=None,
            sender=OPERATOR.sender,
            key=None,
        )

        def write(connection: StoreConnection) -> None:
            notes.add(connection, note, shift)

        await self._events.record(
            **WRITE_NOTE.by(OPERATOR, start=site_time(shift.start, self._zone)),
            bus=self._bus,
            unit=unit,
            message=text,
            also=write,
        )

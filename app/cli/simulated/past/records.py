"""What people and units did in the past of a demo: events, alarms, recipes, a golden set and notes."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator
from contextlib import closing
from functools import partial
from zoneinfo import ZoneInfo

from app.alarms.acts import ACKNOWLEDGE
from app.alarms.alarm import Alarm, built_in
from app.alarms.journal.store import AlarmStore, entry_of
from app.alarms.rules.performance import ObservedSpan
from app.alarms.rules.state_machine import AlarmFacts, Transition
from app.audit.acts import Act
from app.audit.keys import open_keys
from app.audit.log import EventLog
from app.audit.proof import heads_of
from app.cli.simulated.past.story import Incident, Past, setpoint_of
from app.conditions.catalogue import CONDITIONS
from app.database import Database, StoreConnection
from app.handover.acts import WRITE_NOTE
from app.handover.notes import notes
from app.handover.notes.notes import Note
from app.handover.rules.shift_times import shift_at, site_time
from app.recipes import acts as recipe_acts
from app.recipes.rules import Recipe, RecipeSetpoint
from app.recipes.store import RecipeStore
from app.sets import acts as set_acts
from app.sets.model import ParameterRow, ParameterSet, UnitRows
from app.sets.store import SetStore
from app.settings import Settings
from app.web.admission.access import Person, Role
from bus.catalogue import numbers
from bus.catalogue.parameters import PARAMETERS
from bus.instants import UnixTime
from bus.messages import Message, term

OPERATOR, ENGINEER = (Person(f"demo-{role.value}", role, "demo") for role in (Role.OPERATOR, Role.ENGINEER))
GOLDEN_HOURS_AGO, DRIFTED = 20.0, 3
"""The set is older than the change of the ramp of this unit, which was made at its keypad."""
DRIFT_TENTHS = 30
MAX_GOLDEN = 16
"""How many units have a golden set: each is read completely soon after the start."""
_NOTES: tuple[tuple[float, int | None, str], ...] = (
    (19.2, 3, "Simulated: web break at the coater, threaded again. Blade checked, no damage."),
    (13.3, None, "Simulated: changed from primer 90 to coating 120."),
    (9.0, 5, "Simulated: dryer 2 did not respond for two minutes, connector tightened."),
    (0.6, 4, "Simulated: emergency stop at dryer 1 is still to be explained."),
)
_Record = tuple[UnixTime, Callable[[], Awaitable[None]]]


def write_records(settings: Settings, past: Past) -> None:
    """Write them in the order of time, as the log has them. Raises StoreError."""
    with closing(Database(settings.server.store, synchronous="NORMAL")) as database:
        asyncio.run(_Records(settings, database, past).write())


class _Records:
    """Writes each record at its time."""

    def __init__(self, settings: Settings, database: Database, past: Past) -> None:
        self._past, self._database, self._bus = past, database, settings.bus[0].name
        self._now = past.begins
        keys = open_keys(settings.key_files, database.path, database.read_now(heads_of))
        self._events = EventLog(database, lambda: self._now, keys)
        self._alarms = AlarmStore(database)
        self._recipes, self._sets = RecipeStore(database), SetStore(database)
        self._zone, self._shifts = ZoneInfo(settings.site.zone), settings.shift.minutes
        self._occurrences: Counter[str] = Counter()

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
        for hours, unit, text in _NOTES:
            if unit is None or unit <= len(self._past.units):
                yield ago(hours), partial(self._note, unit, text)
        for incident in self._past.incidents:
            yield from self._changes(incident)

    def _changes(self, incident: Incident) -> Iterator[_Record]:
        """The beginning and the end of an incident, its alarm, and what acknowledged it."""
        definition = built_in(incident.code, self._bus, incident.unit)
        self._occurrences[definition.key] += 1
        occurrence = self._occurrences[definition.key]
        yield incident.began, partial(self._line_event, incident, holds=True)
        yield incident.ended, partial(self._line_event, incident, holds=False)
        acknowledged = incident.acknowledged_at
        rise = Transition(incident.began, "rise", occurrence, "normal", "unack_active")
        is_late = acknowledged is None or acknowledged > incident.ended
        clear = (
            Transition(incident.ended, "clear", occurrence, "unack_active", "rtn_unack")
            if is_late
            else Transition(incident.ended, "clear", occurrence, "ack_active", "normal")
        )
        entries = [entry_of(definition, rise), entry_of(definition, clear)]
        facts = AlarmFacts(
            acknowledged=acknowledged is not None,
            occurrence=occurrence,
            since=incident.ended,
            came=incident.began,
            cleared=incident.ended,
            acknowledged_at=acknowledged,
        )
        if acknowledged is not None:
            change = (
                Transition(acknowledged, "acknowledge", occurrence, "rtn_unack", "normal")
                if is_late
                else Transition(acknowledged, "acknowledge", occurrence, "unack_active", "ack_active")
            )
            entries.append(entry_of(definition, change, OPERATOR.name))
            yield acknowledged, partial(self._acknowledged, incident.unit, definition.name)
        entries.sort(key=lambda entry: float(entry.at))
        ended = max(incident.ended, acknowledged or incident.ended)
        yield ended, partial(self._alarms.write, entries, [Alarm(definition, facts)])

    async def _line_event(self, incident: Incident, *, holds: bool) -> None:
        event = CONDITIONS[incident.code].event
        assert event is not None
        what = Message(event.began if holds else event.ended)
        old, new = (event.off, event.on) if holds else (event.on, event.off)
        await self._events.record(
            kind=event.kind, bus=self._bus, unit=incident.unit, what=what, old=old, new=new
        )

    async def _acknowledged(self, unit: int, name: Message | str) -> None:
        await self._events.record(**ACKNOWLEDGE.by(OPERATOR, name=name), bus=self._bus, unit=unit)

    async def _recipe(self, name: str, share: float, *, loaded: bool) -> None:
        known = [each for each in await self._recipes.newest(self._bus) if each.name == name]
        setpoints = tuple(
            RecipeSetpoint(address, setpoint_of(unit, share), "ratio" if unit.follows else "speed")
            for address, unit in enumerate(self._past.units, start=1)
        )
        if known:
            recipe = known[0]
        else:
            recipe = Recipe(self._bus, name, "simulated", ENGINEER.name, self._now, setpoints)
            recipe = await self._recipes.save(recipe)
            await self._record_recipe(recipe_acts.SAVE, ENGINEER, recipe)
        if loaded:
            await self._recipes.mark_loaded(self._bus, recipe.id, OPERATOR.name, self._now)
            await self._record_recipe(recipe_acts.LOAD, OPERATOR, recipe)

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
        saved = set_acts.SAVE.by(ENGINEER, set=kept.id, units=[*units], origin=term(kept.origin))
        await self._events.record(**saved, bus=self._bus)
        golden = units[:MAX_GOLDEN]
        await self._sets.mark_golden(self._bus, golden, kept.id, ENGINEER.name, self._now)
        for unit in golden:
            await self._events.record(
                **set_acts.MARK_GOLDEN.by(ENGINEER, set=kept.id, unit=unit), bus=self._bus, unit=unit
            )

    def _parameters(self, address: int) -> dict[int, ParameterRow]:
        """As the unit has them now, but for the drift; the operator password is masked."""
        memory = self._past.units[address - 1].memory
        raws = {number: None if row.secret else memory[number] for number, row in PARAMETERS.items()}
        if address == min(DRIFTED, len(self._past.units)):
            raws[numbers.ACCELERATION] = memory[numbers.ACCELERATION] - DRIFT_TENTHS
        return {number: ParameterRow(number, raw, read_at=self._now) for number, raw in raws.items()}

    async def _note(self, unit: int | None, text: str) -> None:
        shift = shift_at(self._now, self._shifts, self._zone)
        note = Note(
            at=self._now,
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

"""Alarms at rest: the facts of each, and the journal of every transition."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Annotated, Any, TypeVar

from pydantic import Field

from app.core.database import Database, StoreConnection, StoreRow
from app.core.database.connection import upsert
from app.line.alarms.alarm import Alarm, AlarmDefinition, BusName, UnitNumber, state_text
from app.line.alarms.rules.performance import ObservedSpan
from app.line.alarms.rules.state_machine import AlarmFacts, AlarmState, AlarmTrigger, Transition
from app.line.conditions.priority import AlarmPriority
from bus.instants import UnixTime
from bus.messages import Message

T = TypeVar("T")
_STORED_FACTS = tuple(
    field.name for field in fields(AlarmFacts) if field.name not in ("changing_since", "unknown_since")
)
"""A delay begins again after a restart, and what nothing is known of is not known then either."""
_FLAGS = ("active", "acknowledged", "latched", "silenced", "suppressed", "out_of_service", "shelved_once")
_OF_ALARM = ("first_out", "hidden_by", "reason")


@dataclass(frozen=True, slots=True)
class NamedAlarm:
    """An alarm with what it needs to be named without the configuration of its time."""

    alarm: Annotated[str, Field(description="Its id without the occurrence.")]
    code: str
    name: str
    bus: BusName
    unit: UnitNumber

    @property
    def shown_name(self) -> str | Message:
        """The name as it is shown: a built-in alarm has a message, which each reader sees in their
        language."""
        return Message(f"alarm_{self.code}") if self.alarm.endswith(f".{self.code}") else self.name


@dataclass(frozen=True, slots=True)
class RecordedAlarm(NamedAlarm):
    """An occurrence."""

    occurrence: int
    priority: AlarmPriority


@dataclass(frozen=True, slots=True)
class JournalEntry(RecordedAlarm):
    """One transition."""

    at: UnixTime
    trigger: AlarmTrigger
    before: AlarmState
    after: AlarmState
    who: str = ""
    reason: str = ""
    id: int = 0

    @property
    def before_text(self) -> Message:
        return state_text(self.before)

    @property
    def after_text(self) -> Message:
        return Message("alarm_silenced") if self.trigger == "silence" else state_text(self.after)


def entry_of(
    definition: AlarmDefinition, change: Transition, who: str = "", reason: str = ""
) -> JournalEntry:
    """The journal entry of a transition."""
    return JournalEntry(
        at=change.at,
        alarm=definition.key,
        occurrence=change.occurrence,
        code=definition.code,
        name=str(definition.name),
        bus=definition.bus,
        unit=definition.unit,
        priority=definition.priority,
        trigger=change.trigger,
        before=change.before,
        after=change.after,
        who=who,
        reason=reason,
    )


@dataclass(frozen=True, slots=True)
class JournalFilter:
    """Which transitions: of ``alarms`` by their keys, None: of all; of a ``bus`` and a ``unit``, a priority,
    into a state, from ``start`` up to ``end``."""

    alarms: Sequence[str] | None = None
    bus: str | None = None
    unit: int | None = None
    priority: str | None = None
    after: str | None = None
    start: UnixTime | None = None
    end: UnixTime | None = None

    @property
    def sql(self) -> tuple[str, list[Any]]:
        """Conditions, each after AND, and their values."""
        comparisons = {
            "bus = ?": self.bus,
            "unit = ?": self.unit,
            "priority = ?": self.priority,
            "after = ?": self.after,
            "at >= ?": self.start,
            "at < ?": self.end,
        }
        known = {text: value for text, value in comparisons.items() if value is not None}
        conditions, values = "".join(f" AND {text}" for text in known), [*known.values()]
        if self.alarms is None:
            return conditions, values
        marks = ", ".join("?" * len(self.alarms)) or "NULL"
        return f"{conditions} AND alarm IN ({marks})", [*values, *self.alarms]


@dataclass(frozen=True, slots=True)
class StoredAlarm:
    """The facts and marks of an alarm as the store keeps them."""

    facts: AlarmFacts
    first_out: bool
    hidden_by: str
    reason: str


_FACTS = ("alarm", *_STORED_FACTS, *_OF_ALARM)
_COLUMNS = tuple(field.name for field in fields(JournalEntry) if field.name != "id")
_values_of, _facts_of, _marks_of = attrgetter(*_COLUMNS), attrgetter(*_STORED_FACTS), attrgetter(*_OF_ALARM)
_ADD_ENTRY = f"INSERT INTO alarm_journal ({', '.join(_COLUMNS)}) VALUES ({', '.join('?' * len(_COLUMNS))})"
_PUT_FACTS = upsert("alarm_facts", _FACTS[:1], _FACTS[1:])


class AlarmStore:
    """The tables of alarms, their facts and their journal."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def load(self) -> dict[str, StoredAlarm]:
        """The stored facts of each alarm, by its key."""
        return await self._database.read(_load)

    async def find(self, key: str) -> StoredAlarm | None:
        """The stored facts of one alarm; None: it never left its first state."""
        return (await self._database.read(lambda connection: _load(connection, key))).get(key)

    async def write(self, entries: Sequence[JournalEntry], alarms: Iterable[Alarm]) -> None:
        """Transitions in order, and the facts that they led to, in one transaction."""
        await self._database.write(alarm_writer(entries, alarms))

    async def write_observed(self, place: str, span: ObservedSpan) -> None:
        """The alarms of a bus, or of the site, were observed so long."""
        statement = upsert("alarm_observed", ("place", "starts"), ("ends",))
        await self._database.write(lambda connection: connection.execute(statement, (place, *span)))

    async def read_costly(self, work: Callable[[StoreConnection], T]) -> T:
        """A read of many transitions. Raises TooCostlyError after a bounded time."""
        return await self._database.read_costly(work)

    async def journal(
        self,
        limit: int,
        before: int | None = None,
        alarm: str | None = None,
        chosen: JournalFilter | None = None,
    ) -> list[JournalEntry]:
        """Transitions, of all, of one alarm or as ``chosen``, newest first; ``before``: older than this
        entry. Raises TooCostlyError where few of very many are chosen."""
        conditions, values = (chosen or JournalFilter(None if alarm is None else (alarm,))).sql
        where = f"id < ?{conditions} ORDER BY id DESC LIMIT ?"
        query = f"SELECT {', '.join(_COLUMNS)}, id FROM alarm_journal WHERE {where}"
        every = (before or 2**62, *values, limit)
        read = self._database.read_costly if chosen is not None else self._database.read
        rows = await read(lambda connection: connection.execute(query, every).fetchall())
        return [JournalEntry(*row) for row in rows]


def alarm_writer(
    entries: Sequence[JournalEntry], alarms: Iterable[Alarm]
) -> Callable[[StoreConnection], None]:
    """Return a function that writes transitions and facts in a transaction. The rows are made now, as the
    facts may change until they are written."""
    journal = [_values_of(entry) for entry in entries]
    facts = [(alarm.definition.key, *_facts_of(alarm.facts), *_marks_of(alarm)) for alarm in alarms]

    def write(connection: StoreConnection) -> None:
        connection.executemany(_ADD_ENTRY, journal)
        connection.executemany(_PUT_FACTS, facts)

    return write


def _load(connection: StoreConnection, key: str | None = None) -> dict[str, StoredAlarm]:
    query = f"SELECT {', '.join(_FACTS)} FROM alarm_facts WHERE alarm = :key OR :key IS NULL"
    return {row["alarm"]: _stored(row) for row in connection.execute(query, {"key": key})}


def _stored(row: StoreRow) -> StoredAlarm:
    values = {name: row[name] for name in _STORED_FACTS}
    facts = AlarmFacts(**values | {name: bool(values[name]) for name in _FLAGS})
    return StoredAlarm(facts, bool(row["first_out"]), row["hidden_by"], row["reason"])

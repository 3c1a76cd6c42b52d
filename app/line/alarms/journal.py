"""The tables of alarms: the facts of each, the journal of every transition, and what follows from the journal
over a span: the occurrences for charts, and the figures of ISA-18.2."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from heapq import merge
from itertools import islice
from operator import attrgetter
from typing import Annotated, Any, TypeVar

from pydantic import Field

from app.core.database import Database, StoreConnection, StoreRow
from app.core.database.connection import upsert
from app.core.web.shape import InstantObject
from app.line.alarms.alarm import Alarm, AlarmDefinition, BusName, UnitNumber, state_text
from app.line.alarms.performance import (
    CHATTERS_S,
    FLEETING_S,
    STALE_S,
    WINDOW_S,
    AlarmCounts,
    AlarmFigure,
    FigureCode,
    ObservedSpan,
    figures,
    observed_within,
    pace_of,
)
from app.line.alarms.rules import AlarmFacts, AlarmState, AlarmTrigger, Transition
from app.line.conditions.condition import AlarmPriority
from bus.instants import UnixTime
from bus.messages import Message

T = TypeVar("T")
_STORED_FACTS = tuple(
    field.name for field in fields(AlarmFacts) if field.name not in ("changing_since", "unknown_since")
)
"""Facts that are stored: a delay begins again after a restart, and unknown conditions are looked at anew."""
_FLAGS = ("active", "acknowledged", "latched", "silenced", "suppressed", "out_of_service", "shelved_once")
_OF_ALARM = ("first_out", "hidden_by", "reason")


@dataclass(frozen=True, slots=True)
class NamedAlarm:
    """An alarm of the journal, named without the configuration of its time."""

    alarm: Annotated[str, Field(description="Its id without the occurrence.")]
    code: str
    name: str
    bus: BusName
    unit: UnitNumber

    @property
    def shown_name(self) -> str | Message:
        """The name to show: for a built-in alarm a message, which is in the language of each reader."""
        return Message(f"alarm_{self.code}") if self.alarm.endswith(f".{self.code}") else self.name


@dataclass(frozen=True, slots=True)
class RecordedAlarm(NamedAlarm):
    """An occurrence of an alarm."""

    occurrence: int
    priority: AlarmPriority


@dataclass(frozen=True, slots=True)
class JournalEntry(RecordedAlarm):
    """A transition of an alarm."""

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
        """What an alarm is after the transition; of one that stays hidden also what its condition does."""
        if self.trigger == "silence":
            return Message("alarm_silenced")
        if self.before == self.after and self.trigger in ("rise", "clear"):
            return Message.of(f"alarm_stays_{self.trigger}", state=state_text(self.after))
        return state_text(self.after)


def entry_of(
    definition: AlarmDefinition, change: Transition, who: str = "", reason: str = ""
) -> JournalEntry:
    """Make the journal entry of a transition."""
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
    """A choice of transitions: of ``alarms`` by their keys (None: all), of a bus, a unit, a priority, into
    the state ``after``, from ``start`` up to ``end``."""

    alarms: Sequence[str] | None = None
    bus: str | None = None
    unit: int | None = None
    priority: str | None = None
    after: str | None = None
    start: UnixTime | None = None
    end: UnixTime | None = None

    @property
    def sql(self) -> tuple[str, list[Any]]:
        """The conditions in SQL, each after AND, and their values."""
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
    first_out: int
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
        """Return the stored facts of each alarm, by its key."""
        return await self._database.read(_load)

    async def find(self, key: str) -> StoredAlarm | None:
        """Return the stored facts of one alarm; None: the alarm never left its first state."""
        return (await self._database.read(lambda connection: _load(connection, key))).get(key)

    async def write(self, entries: Sequence[JournalEntry], alarms: Iterable[Alarm]) -> None:
        """Write transitions, in order, and the facts that they led to, in one transaction."""
        await self._database.write(alarm_writer(entries, alarms))

    async def write_observed(self, place: str, span: ObservedSpan) -> None:
        """Write the time in which the alarms of a bus, or of the site, were observed."""
        statement = upsert("alarm_observed", ("place", "starts"), ("ends",))
        await self._database.write(lambda connection: connection.execute(statement, (place, *span)))

    async def read_costly(self, work: Callable[[StoreConnection], T]) -> T:
        """Read many transitions. Raise TooCostlyError after a bounded time."""
        return await self._database.read_costly(work)

    async def journal(
        self,
        limit: int,
        before: int | None = None,
        alarm: str | None = None,
        chosen: JournalFilter | None = None,
    ) -> list[JournalEntry]:
        """Return transitions, newest first: all, those of one alarm, or as ``chosen``; ``before``: those
        older than this entry. Raise TooCostlyError if few of very many are chosen."""
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
    """Return a function that writes transitions and facts in a transaction. The rows are made now: the facts
    may change before they are written."""
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
    return StoredAlarm(facts, row["first_out"], row["hidden_by"], row["reason"])


MAX_OCCURRENCES = 500
_ACTIVE = ("unack_active", "ack_active")
_LAST = (
    "SELECT MAX(id) FROM (SELECT id FROM alarm_journal WHERE at < ? ORDER BY at DESC LIMIT 1000) AS newest"
)
"""The newest transition before a time. Transitions of several buses are in order except for moments."""


@dataclass(frozen=True, slots=True)
class Occurrence(RecordedAlarm):
    """An occurrence: annunciated at ``start`` and active until ``end`` (None: it still is). If the clock was
    set back by more than the occurrence had lasted, the end is the start."""

    start: UnixTime
    end: UnixTime | None


_OF_OCCURRENCE = tuple(field.name for field in fields(RecordedAlarm))
_EDGE = f"((before IN {_ACTIVE}) <> (after IN {_ACTIVE}))"
"""A transition with which an occurrence begins or ends, as in the partial index ``alarm_journal_edges``."""
_BACKWARD = (
    "SELECT * FROM alarm_journal INDEXED BY alarm_journal_edges"
    f" WHERE alarm = ? AND id < ? AND {_EDGE} ORDER BY id DESC LIMIT ?"
)
_NEXT = (
    "SELECT at FROM alarm_journal INDEXED BY alarm_journal_edges"
    f" WHERE alarm = ? AND id > ? AND {_EDGE} ORDER BY id LIMIT 1"
)
_FEW, _MANY = 2, 100
"""Rows of the first read and of each further one: of most alarms only the newest occurrence is needed."""


async def occurrences(
    store: AlarmStore, alarms: Iterable[str], start: UnixTime, end: UnixTime
) -> list[Occurrence]:
    """Return the occurrences of a span, oldest first, even if they began before it. Of more than
    MAX_OCCURRENCES only the newest are returned, and one more. ``alarms``: the keys of alarms."""
    keys = list(alarms)
    return await store.read_costly(lambda connection: _found(connection, keys, start, end))


def _found(
    connection: StoreConnection, alarms: list[str], start: UnixTime, end: UnixTime
) -> list[Occurrence]:
    last: int = connection.execute(_LAST, (end,)).fetchone()[0] or 0
    each_alarm = (_of_alarm(connection, alarm, last, start, end) for alarm in alarms)
    newest_first = merge(*each_alarm, key=lambda each: each.start, reverse=True)
    return sorted(islice(newest_first, MAX_OCCURRENCES + 1), key=lambda each: each.start)


def _of_alarm(
    connection: StoreConnection, alarm: str, last: int, start: UnixTime, end: UnixTime
) -> Iterator[Occurrence]:
    """Yield the occurrences of one alarm, from the newest back to the one at the start of the span."""
    until, is_first = None, True
    for row in _edges(connection, alarm, last):
        if row["after"] not in _ACTIVE:
            until = row["at"]
            if until <= start:
                return
        else:
            if is_first:
                until = _next_end(connection, alarm, last)
            if row["at"] < end:
                yield _occurrence(row, until)
        is_first = False


def _edges(connection: StoreConnection, alarm: str, last: int) -> Iterator[StoreRow]:
    """Yield the rows at which occurrences begin and end, from an entry of the journal back. No cursor stays
    open between two rows."""
    before, limit = last + 1, _FEW
    while rows := connection.execute(_BACKWARD, (alarm, before, limit)).fetchall():
        yield from rows
        before, limit = rows[-1]["id"], _MANY


def _next_end(connection: StoreConnection, alarm: str, last: int) -> UnixTime | None:
    row = connection.execute(_NEXT, (alarm, last)).fetchone()
    return None if row is None else row[0]


def _occurrence(row: StoreRow, end: UnixTime | None) -> Occurrence:
    ends = None if end is None else max(row["at"], end)
    return Occurrence(start=row["at"], end=ends, **{name: row[name] for name in _OF_OCCURRENCE})


MAX_FREQUENT = 10
_ANNUNCIATED = "after = 'unack_active' AND before <> 'unack_active'"
_IN_SPAN = f"{_ANNUNCIATED} AND at >= :start AND at < :end"
_OBSERVED = "SELECT starts, ends FROM alarm_observed WHERE ends > :start AND starts < :end"
_TIMES = f"SELECT at FROM alarm_journal WHERE {_IN_SPAN} ORDER BY at"
_PRIORITIES = f"SELECT priority, COUNT(*) FROM alarm_journal WHERE {_IN_SPAN} GROUP BY 1"
_FREQUENT = (
    "SELECT alarm, max(code), max(name), max(bus), max(unit), COUNT(*) AS times FROM alarm_journal"
    f" WHERE {_IN_SPAN} GROUP BY alarm ORDER BY times DESC, alarm LIMIT {MAX_FREQUENT}"
)
# Entries are in order by their ids. The time between two is unknown if the clock was set back meanwhile.
_CHATTERING = (
    "SELECT COUNT(DISTINCT alarm) FROM (SELECT alarm, at, LAG(at) OVER former AS second,"
    f" LAG(at, 2) OVER former AS first FROM alarm_journal WHERE {_IN_SPAN}"
    " WINDOW former AS (PARTITION BY alarm ORDER BY id)) AS rises"
    f" WHERE first <= second AND second <= at AND at - first <= {CHATTERS_S}"
)
_FLEETING = (
    f"SELECT COUNT(*) FROM alarm_journal AS risen WHERE {_IN_SPAN} AND trigger = 'rise'"
    f" AND (SELECT trigger = 'clear' AND at BETWEEN risen.at AND risen.at + {FLEETING_S}"
    " FROM alarm_journal INDEXED BY alarm_journal_by_alarm"
    " WHERE alarm = risen.alarm AND id > risen.id ORDER BY id LIMIT 1)"
)
_ACKNOWLEDGED = (
    "SELECT at - (SELECT at FROM alarm_journal INDEXED BY alarm_journal_by_alarm WHERE alarm = seen.alarm"
    f" AND id < seen.id AND {_ANNUNCIATED} ORDER BY id DESC LIMIT 1) AS after_s"
    " FROM alarm_journal AS seen WHERE trigger = 'acknowledge' AND at >= :start AND at < :end"
)
_MEDIAN = (
    f"SELECT AVG(after_s) FROM (SELECT after_s, ROW_NUMBER() OVER (ORDER BY after_s) AS place,"
    f" COUNT(*) OVER () AS every FROM ({_ACKNOWLEDGED}) AS seen WHERE after_s >= 0) AS ordered"
    " WHERE place IN ((every + 1) / 2, (every + 2) / 2)"
)


@dataclass(frozen=True, slots=True)
class FrequentAlarm(NamedAlarm):
    """An alarm that is among the ten most frequent."""

    times: Annotated[int, Field(description="How often it was annunciated.")]


@dataclass(frozen=True, slots=True)
class AlarmPerformance:
    """The figures of a span, and how much of it alarms were observed."""

    start: Annotated[
        InstantObject,
        Field(serialization_alias="from", description="Where alarms were observed only later: then."),
    ]
    end: Annotated[InstantObject, Field(serialization_alias="to")]
    observed_s: Annotated[float, Field(description="How long alarms were observed in this time.")]
    figures: list[AlarmFigure]
    most_frequent: list[FrequentAlarm]

    @property
    def is_observed(self) -> bool:
        """Whether enough of the span was observed for figures."""
        return self.observed_s >= WINDOW_S

    def covers(self, span_s: float) -> bool:
        """Return whether all of a span of this length was observed, apart from a restart."""
        return span_s - self.observed_s < WINDOW_S


async def measure(
    store: AlarmStore,
    present: Iterable[AlarmFacts],
    observed: Sequence[ObservedSpan],
    start: UnixTime,
    end: UnixTime,
) -> AlarmPerformance:
    """Return the figures of a span. ``present``: the facts of the alarms that are not normal; ``observed``:
    the spans of this run, which the store learns a minute late. Raise TooCostlyError."""
    now = _now(present, end)
    return await store.read_costly(lambda connection: _measured(connection, start, end, observed, now))


def _measured(
    connection: StoreConnection,
    start: UnixTime,
    end: UnixTime,
    present: Sequence[ObservedSpan],
    now: dict[FigureCode, int],
) -> AlarmPerformance:
    span = {"start": start, "end": end}
    stored = (ObservedSpan(*row) for row in connection.execute(_OBSERVED, span))
    observed = observed_within((*stored, *present), start, end)
    observed_s = sum(each.end - each.start for each in observed)

    def value(query: str) -> float | None:
        found: float | None = connection.execute(query, span).fetchone()[0]
        return found

    frequent = [FrequentAlarm(*row) for row in connection.execute(_FREQUENT, span)]
    measured = AlarmCounts(
        observed_s=observed_s,
        pace=pace_of((at for (at,) in connection.execute(_TIMES, span)), float(end)),
        top_ten=sum(each.times for each in frequent),
        of_priority=dict(tuple(row) for row in connection.execute(_PRIORITIES, span)),
        chattering=int(value(_CHATTERING) or 0),
        fleeting=int(value(_FLEETING) or 0),
        acknowledge_median_s=value(_MEDIAN),
        now=now,
    )
    begins = observed[0].start if observed else start
    return AlarmPerformance(begins, end, round(observed_s, 3), figures(measured), frequent)


def _now(present: Iterable[AlarmFacts], now: UnixTime) -> dict[FigureCode, int]:
    """Count the present states, whatever the span."""
    present = list(present)
    states = Counter(facts.state for facts in present)
    risen = [facts.came for facts in present if facts.active and not facts.is_hidden]
    return {
        "stale": sum(at is not None and now - at > STALE_S for at in risen),
        "standing": len(risen),
        "shelved": states["shelved"],
        "suppressed": states["suppressed"],
        "out_of_service": states["out_of_service"],
    }

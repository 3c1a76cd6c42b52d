"""When alarms were annunciated and active, from the journal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from heapq import merge
from itertools import islice

from app.alarms.journal.store import AlarmStore, RecordedAlarm
from app.database import StoreConnection, StoreRow
from bus.instants import UnixTime

MAX_OCCURRENCES = 500
_ACTIVE = ("unack_active", "ack_active")
_LAST = (
    "SELECT MAX(id) FROM (SELECT id FROM alarm_journal WHERE at < ? ORDER BY at DESC LIMIT 1000) AS newest"
)
"""The newest transition before a time. Transitions of several buses are in order but for moments."""


@dataclass(frozen=True, slots=True)
class Occurrence(RecordedAlarm):
    """An alarm was annunciated at ``start`` and active until ``end``; None: it still is. One during which the
    clock was set back by more than it had lasted ends at its start."""

    start: UnixTime
    end: UnixTime | None


_COLUMNS = tuple(field.name for field in fields(RecordedAlarm))
_EDGE = f"((before IN {_ACTIVE}) <> (after IN {_ACTIVE}))"
"""An occurrence begins or ends; as the partial index ``alarm_journal_edges`` has it."""
_BACKWARD = (
    "SELECT * FROM alarm_journal INDEXED BY alarm_journal_edges"
    f" WHERE alarm = ? AND id < ? AND {_EDGE} ORDER BY id DESC LIMIT ?"
)
_NEXT = (
    "SELECT at FROM alarm_journal INDEXED BY alarm_journal_edges"
    f" WHERE alarm = ? AND id > ? AND {_EDGE} ORDER BY id LIMIT 1"
)
_FEW, _MANY = 2, 100
"""Rows of a read, the first and each further one: of most alarms only the newest occurrence is needed."""


async def occurrences(
    store: AlarmStore, alarms: Iterable[str], start: UnixTime, end: UnixTime
) -> list[Occurrence]:
    """Occurrences of a span, also where they began before it; of more than MAX_OCCURRENCES the newest and one
    more, oldest first. ``alarms``: their keys."""
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
    """From the newest back to the one at the start of the span."""
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
    """Where occurrences begin and end, from an entry of the journal back. None is kept open between two."""
    before, limit = last + 1, _FEW
    while rows := connection.execute(_BACKWARD, (alarm, before, limit)).fetchall():
        yield from rows
        before, limit = rows[-1]["id"], _MANY


def _next_end(connection: StoreConnection, alarm: str, last: int) -> UnixTime | None:
    row = connection.execute(_NEXT, (alarm, last)).fetchone()
    return None if row is None else row[0]


def _occurrence(row: StoreRow, end: UnixTime | None) -> Occurrence:
    ends = None if end is None else max(row["at"], end)
    return Occurrence(start=row["at"], end=ends, **{name: row[name] for name in _COLUMNS})

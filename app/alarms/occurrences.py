"""When alarms were annunciated and active, from the journal."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from heapq import nlargest

from app.alarms.rules.priority import AlarmPriority
from app.alarms.store import AlarmStore
from bus.instants import UnixTime

MOST_OCCURRENCES = 500
_ACTIVE = ("unack_active", "ack_active")
_LAST = "SELECT MAX(id) FROM (SELECT id FROM alarm_journal WHERE at < ? ORDER BY at DESC LIMIT 1000)"
"""Of the transitions before a time. Those of several buses are in order but for moments."""


@dataclass(frozen=True, slots=True)
class Occurrence:
    """An alarm was annunciated at ``start`` and active until ``end``; None: it still is. One during which the
    clock was set back by more than it had lasted ends at its start."""

    alarm: str
    occurrence: int
    code: str
    name: str
    bus: str | None
    unit: int | None
    priority: AlarmPriority
    start: UnixTime
    end: UnixTime | None


_COLUMNS = tuple(field.name for field in fields(Occurrence) if field.name != "end")
_BACKWARD = "SELECT *, at AS start FROM alarm_journal WHERE alarm = ? AND id <= ? ORDER BY id DESC"
_NEXT_END = (
    f"SELECT at FROM alarm_journal WHERE alarm = ? AND id > ? AND after NOT IN {_ACTIVE} ORDER BY id LIMIT 1"
)


async def occurrences(
    store: AlarmStore, alarms: Iterable[str], start: UnixTime, end: UnixTime
) -> list[Occurrence]:
    """Those of a span, also where they began before it; of more than MOST_OCCURRENCES the newest and one
    more, oldest first. ``alarms``: their keys."""
    keys = list(alarms)
    return await store.read_costly(lambda connection: _found(connection, keys, start, end))


def _found(
    connection: sqlite3.Connection, alarms: list[str], start: UnixTime, end: UnixTime
) -> list[Occurrence]:
    last: int = connection.execute(_LAST, (end,)).fetchone()[0] or 0
    every = (each for alarm in alarms for each in _of_alarm(connection, alarm, last, start, end))
    return nlargest(MOST_OCCURRENCES + 1, every, key=lambda each: each.start)[::-1]


def _of_alarm(
    connection: sqlite3.Connection, alarm: str, last: int, start: UnixTime, end: UnixTime
) -> Iterator[Occurrence]:
    """From the newest back to the one at the start of the span."""
    found, opened, until = 0, None, None
    for row in connection.execute(_BACKWARD, (alarm, last)):
        if row["after"] in _ACTIVE:
            if opened is None and until is None:
                until = _next_end(connection, alarm, last)
            opened = row if row["start"] < end else None
            continue
        if opened is not None:
            found += 1
            yield _occurrence(opened, until)
        opened, until = None, row["start"]
        if until <= start or found > MOST_OCCURRENCES:
            return
    if opened is not None:
        yield _occurrence(opened, until)


def _next_end(connection: sqlite3.Connection, alarm: str, last: int) -> UnixTime | None:
    row = connection.execute(_NEXT_END, (alarm, last)).fetchone()
    return None if row is None else row[0]


def _occurrence(row: sqlite3.Row, end: UnixTime | None) -> Occurrence:
    ends = None if end is None else max(row["start"], end)
    return Occurrence(end=ends, **{name: row[name] for name in _COLUMNS})

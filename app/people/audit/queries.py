"""Queries of the events: filtered and searched, each command with its outcome."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from app.core.database import StoreConnection
from app.core.database.connection import json_member
from app.people.audit.entry import readable
from bus.instants import UnixTime

_FOLDED = """
SELECT e.id, e.time, e.kind, e.who, e.origin, e.bus, e.unit, e.what,
       COALESCE(f.old, e.old) AS old, COALESCE(f.new, e.new) AS new, e.old_raw, e.new_raw,
       COALESCE(f.outcome, e.outcome) AS outcome, COALESCE(f.message, e.message) AS message,
       COALESCE(f.frames, e.frames) AS frames, e.count, f.time AS concluded_at,
       e.messages, f.messages AS concluded_messages
FROM events e LEFT JOIN events f ON f.about = e.id
WHERE e.about IS NULL
"""
UnitPlace = tuple[str, int]
"""The name of a bus, and the address of a unit."""
_SEARCHED = ("what", "who", "old", "new", "message")
_IN_GROUP = """
SELECT 1 FROM event_parts JOIN events change ON change.id = event_parts.change
LEFT JOIN events change_result ON change_result.about = change.id
WHERE event_parts.event = e.id
"""


@dataclass(frozen=True)
class Filter:
    """The events of a query; None or empty does not filter. Times are in seconds since the epoch.

    ``code`` and ``number``: those of the message in ``what``, which older events do not have; ``named``:
    units that ``search`` names, whose events are found too; ``newest``: only so many of the newest entries
    are searched, which bounds the cost; ``folded``: without the parts of a change that is in the result;
    ``parts_of``: only the parts of these changes."""

    before: int | None = None
    kind: str | None = None
    bus: str | None = None
    unit: int | None = None
    who: str | None = None
    since: UnixTime | None = None
    until: UnixTime | None = None
    search: str = ""
    named: tuple[UnitPlace, ...] = ()
    code: str | None = None
    number: int | None = None
    old_raw: int | None = None
    new_raw: int | None = None
    folded: bool = False
    parts_of: tuple[int, ...] | None = None
    after: int | None = None
    newest: int | None = None

    def conditions(self, event: str = "e", conclusion: str = "f") -> tuple[str, list[Any]]:
        """Return SQL to append to a query, and its values. ``event``, ``conclusion``: the aliases of the
        events and of their conclusions in the query."""
        messages = f"{event}.messages"
        number = None if self.number is None else str(self.number)
        given = {
            f"{event}.id < ?": self.before,
            f"{event}.id > ?": self.after,
            f"{event}.id > (SELECT max(id) FROM events) - ?": self.newest,
            f"{event}.kind = ?": self.kind,
            f"{event}.bus = ?": self.bus,
            f"{event}.unit = ?": self.unit,
            f"{event}.who = ?": self.who,
            f"{event}.time >= ?": self.since,
            f"{event}.time < ?": self.until,
            f"{event}.old_raw = ?": self.old_raw,
            f"{event}.new_raw = ?": self.new_raw,
            f"{json_member(messages, 'what.code')} = ?": self.code,
            f"{json_member(messages, 'what.params.number')} = ?": number,
        }
        parts = [f"AND {condition}" for condition, value in given.items() if value is not None]
        values: list[Any] = [value for value in given.values() if value is not None]
        if self.search:
            columns = (*(f"{event}.{column}" for column in _SEARCHED), f"{conclusion}.message")
            either = [f"{column} LIKE ? ESCAPE '!'" for column in columns]
            if self.named:
                either.append(
                    f"({event}.bus, {event}.unit) IN (VALUES {', '.join(['(?, ?)'] * len(self.named))})"
                )
            parts.append(f"AND ({' OR '.join(either)})")
            values += [_pattern(self.search)] * len(columns)
            values += [part for place in self.named for part in place]
        for clause, more in self._grouping():
            parts.append(clause)
            values += more
        return " ".join(parts), values

    def _grouping(self) -> Iterator[tuple[str, list[Any]]]:
        if self.folded:
            group, values = replace(self, before=None, folded=False, parts_of=None).conditions(
                "change", "change_result"
            )
            yield f"AND NOT EXISTS ({_IN_GROUP} {group})", values
        if self.parts_of is not None:
            marks = ", ".join("?" * len(self.parts_of))
            yield f"AND e.id IN (SELECT event FROM event_parts WHERE change IN ({marks}))", [*self.parts_of]


def _pattern(text: str) -> str:
    for special in "!%_":
        text = text.replace(special, f"!{special}")
    return f"%{text}%"


def select(connection: StoreConnection, wanted: Filter, limit: int) -> list[dict[str, Any]]:
    """Return events newest first, each command with its outcome."""
    conditions, values = wanted.conditions()
    query = f"{_FOLDED} {conditions} ORDER BY e.id DESC LIMIT ?"
    return [readable(dict(row)) for row in connection.execute(query, [*values, limit])]


def one(connection: StoreConnection, number: int) -> dict[str, Any] | None:
    """Return one event with its outcome."""
    row = connection.execute(f"{_FOLDED} AND e.id = ?", (number,)).fetchone()
    return readable(dict(row)) if row else None


def kinds(connection: StoreConnection) -> list[str]:
    """Return the kinds of all events, each found by one look into the index."""
    query = (
        "WITH RECURSIVE k(kind) AS (SELECT min(kind) FROM events WHERE about IS NULL UNION ALL "
        "SELECT (SELECT min(kind) FROM events WHERE about IS NULL AND kind > k.kind) FROM k "
        "WHERE kind IS NOT NULL) SELECT kind FROM k WHERE kind IS NOT NULL"
    )
    return [row["kind"] for row in connection.execute(query)]


def open_intents(connection: StoreConnection) -> list[int]:
    """Return the numbers of commands without an outcome."""
    query = (
        "SELECT id FROM events e WHERE e.kind = 'command' AND e.about IS NULL AND e.outcome IS NULL "
        "AND NOT EXISTS (SELECT 1 FROM events f WHERE f.about = e.id)"
    )
    return [row["id"] for row in connection.execute(query)]


def link_parts(connection: StoreConnection, count: int) -> None:
    """Note that the last ``count`` events are parts of the one before them, in the transaction that wrote
    them."""
    [last] = connection.execute("SELECT max(id) FROM events").fetchone()
    rows = [(number, last - count) for number in range(last - count + 1, last + 1)]
    connection.executemany("INSERT INTO event_parts (event, change) VALUES (?, ?)", rows)

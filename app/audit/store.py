"""The events table: appended to, read, never changed."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from app.audit.chain import FIELDS, Head, Verdict, entry_hash, verify

_INSERT = (
    f"INSERT INTO events ({', '.join(FIELDS)}, previous, hash) VALUES ({', '.join('?' * (len(FIELDS) + 2))})"
)
_NOTE_HEAD = (
    "INSERT INTO events_head (only, id, hash) VALUES (1, ?, ?) "
    "ON CONFLICT (only) DO UPDATE SET id = excluded.id, hash = excluded.hash"
)
_FOLDED = """
SELECT e.id, e.time, e.kind, e.who, e.origin, e.bus, e.unit, e.what, e.old, e.new, e.old_raw, e.new_raw,
       COALESCE(f.outcome, e.outcome) AS outcome, COALESCE(f.message, e.message) AS message,
       COALESCE(f.frames, e.frames) AS frames, f.time AS concluded_at
FROM events e LEFT JOIN events f ON f.about = e.id
WHERE e.about IS NULL
"""
_SEARCHED = ("what", "who", "old", "new", "message")
_WHOLE = """
SELECT 1 FROM event_parts JOIN events whole ON whole.id = event_parts.whole
LEFT JOIN events whole_fate ON whole_fate.about = whole.id
WHERE event_parts.event = e.id
"""


@dataclass(frozen=True)
class Filter:
    """Which events are wanted; what is None or empty does not narrow. Times in seconds since the epoch.
    ``folded`` leaves out the parts of a change that is wanted itself, ``parts_of`` all but the parts of
    these."""

    before: int | None = None
    kind: str | None = None
    bus: str | None = None
    unit: int | None = None
    who: str | None = None
    since: float | None = None
    until: float | None = None
    search: str = ""
    folded: bool = False
    parts_of: tuple[int, ...] | None = None

    def conditions(self, event: str = "e", fate: str = "f") -> tuple[str, list[Any]]:
        """SQL to append to a query, in which these are the events and their fates, and its values."""
        given = {
            "id < ?": self.before,
            "kind = ?": self.kind,
            "bus = ?": self.bus,
            "unit = ?": self.unit,
            "who = ?": self.who,
            "time >= ?": self.since,
            "time < ?": self.until,
        }
        parts = [f"AND {event}.{condition}" for condition, value in given.items() if value is not None]
        values: list[Any] = [value for value in given.values() if value is not None]
        if self.search:
            columns = (*(f"{event}.{column}" for column in _SEARCHED), f"{fate}.message")
            either = " OR ".join(f"{column} LIKE ? ESCAPE '!'" for column in columns)
            parts.append(f"AND ({either})")
            values += [_pattern(self.search)] * len(columns)
        for clause, more in self._grouping():
            parts.append(clause)
            values += more
        return " ".join(parts), values

    def _grouping(self) -> Iterator[tuple[str, list[Any]]]:
        if self.folded:
            whole, values = replace(self, before=None, folded=False, parts_of=None).conditions(
                "whole", "whole_fate"
            )
            yield f"AND NOT EXISTS ({_WHOLE} {whole})", values
        if self.parts_of is not None:
            marks = ", ".join("?" * len(self.parts_of))
            yield f"AND e.id IN (SELECT event FROM event_parts WHERE whole IN ({marks}))", [*self.parts_of]


def _pattern(text: str) -> str:
    for special in "!%_":
        text = text.replace(special, f"!{special}")
    return f"%{text}%"


def head_of(connection: sqlite3.Connection) -> Head:
    """The newest entry as noted apart."""
    row = connection.execute("SELECT id, hash FROM events_head").fetchone()
    return Head(row["id"], row["hash"]) if row else Head()


def append(connection: sqlite3.Connection, entry: Mapping[str, Any]) -> int:
    """Add an entry (all of `FIELDS` but ``id``); its number."""
    head = head_of(connection)
    whole = {**entry, "id": head.id + 1}
    digest = entry_hash(head.hash, whole)
    connection.execute(_INSERT, [*(whole[name] for name in FIELDS), head.hash, digest])
    connection.execute(_NOTE_HEAD, (whole["id"], digest))
    return head.id + 1


def select(connection: sqlite3.Connection, wanted: Filter, limit: int) -> list[dict[str, Any]]:
    """Events newest first, each command with its fate."""
    conditions, values = wanted.conditions()
    query = f"{_FOLDED} {conditions} ORDER BY e.id DESC LIMIT ?"
    return [dict(row) for row in connection.execute(query, [*values, limit])]


def one(connection: sqlite3.Connection, number: int) -> dict[str, Any] | None:
    """One event with its fate."""
    row = connection.execute(f"{_FOLDED} AND e.id = ?", (number,)).fetchone()
    return dict(row) if row else None


def kinds(connection: sqlite3.Connection) -> list[str]:
    """Every kind there is an event of."""
    query = "SELECT DISTINCT kind FROM events WHERE about IS NULL ORDER BY kind"
    return [row["kind"] for row in connection.execute(query)]


def open_intents(connection: sqlite3.Connection) -> list[dict[str, Any]]:
    """Commands that were begun and have no fate."""
    query = (
        "SELECT * FROM events e WHERE e.kind = 'command' AND e.about IS NULL AND e.outcome IS NULL "
        "AND NOT EXISTS (SELECT 1 FROM events f WHERE f.about = e.id)"
    )
    return [dict(row) for row in connection.execute(query)]


def _entries(connection: sqlite3.Connection) -> Iterator[dict[str, Any]]:
    for row in connection.execute("SELECT * FROM events ORDER BY id"):
        yield dict(row)


def prove(connection: sqlite3.Connection) -> Verdict:
    """Walk the whole log, in one read transaction so that it stands still meanwhile."""
    connection.execute("BEGIN")
    try:
        return verify(_entries(connection), head_of(connection))
    finally:
        connection.execute("ROLLBACK")

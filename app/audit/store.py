"""The events table: appended to, read, never changed."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from app.audit import search
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
AT_SIGHT = 20_000
"""Events that a search reads without the index: some 20 ms."""
_SEARCHED = ("e.what", "e.who", "e.old", "e.new", "e.message", "f.message")


@dataclass(frozen=True)
class Filter:
    """Which events are wanted; what is None or empty does not narrow. Times in seconds since the epoch."""

    before: int | None = None
    kind: str | None = None
    bus: str | None = None
    unit: int | None = None
    who: str | None = None
    since: float | None = None
    until: float | None = None
    search: str = ""

    def conditions(self) -> tuple[str, list[Any]]:
        """SQL to append to a query of events ``e`` and its values."""
        given = {
            "e.id < ?": self.before,
            "e.kind = ?": self.kind,
            "e.bus = ?": self.bus,
            "e.unit = ?": self.unit,
            "e.who = ?": self.who,
            "e.time >= ?": self.since,
            "e.time < ?": self.until,
        }
        parts = [f"AND {condition}" for condition, value in given.items() if value is not None]
        values: list[Any] = [value for value in given.values() if value is not None]
        if self.search:
            either = " OR ".join(f"{column} LIKE ? ESCAPE '!'" for column in _SEARCHED)
            parts.append(f"AND ({either})")
            values += [_pattern(self.search)] * len(_SEARCHED)
        return " ".join(parts), values


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
    """Events newest first, each command with its fate.

    A search looks through the newest `AT_SIGHT` row by row, which is enough for a word that is in many, and
    finds the others by the index: a word that is in few has few rows there.
    """
    phrase, lowest = search.phrase(wanted.search), search.lowest_indexed(connection)
    if not phrase or lowest is None:
        return _select(connection, wanted, limit)
    sight = max(_first_after(connection, wanted) - AT_SIGHT, lowest)
    found = _select(connection, wanted, limit, "AND e.id >= ?", sight)
    if len(found) < limit:
        indexed = f"AND e.id < ? AND e.id >= ? AND e.id IN ({search.MATCHING})"
        found += _select(connection, wanted, limit - len(found), indexed, sight, lowest, phrase)
    if len(found) < limit and lowest > 1:
        found += _select(connection, wanted, limit - len(found), "AND e.id < ?", lowest)
    return found


def _select(
    connection: sqlite3.Connection, wanted: Filter, limit: int, more: str = "", *values: object
) -> list[dict[str, Any]]:
    conditions, wanted_values = wanted.conditions()
    query = f"{_FOLDED} {conditions} {more} ORDER BY e.id DESC LIMIT ?"
    return [dict(row) for row in connection.execute(query, [*wanted_values, *values, limit])]


def _first_after(connection: sqlite3.Connection, wanted: Filter) -> int:
    """The first number that no event before which is asked for has."""
    newest: int = connection.execute("SELECT COALESCE(max(id), 0) + 1 FROM events").fetchone()[0]
    return min(newest, wanted.before or newest)


def one(connection: sqlite3.Connection, number: int) -> dict[str, Any] | None:
    """One event with its fate."""
    row = connection.execute(f"{_FOLDED} AND e.id = ?", (number,)).fetchone()
    return dict(row) if row else None


def kinds(connection: sqlite3.Connection) -> list[str]:
    """Every kind there is an event of, each found by one look into the index."""
    query = (
        "WITH RECURSIVE k(kind) AS (SELECT min(kind) FROM events WHERE about IS NULL UNION ALL "
        "SELECT (SELECT min(kind) FROM events WHERE about IS NULL AND kind > k.kind) FROM k "
        "WHERE kind NOTNULL) SELECT kind FROM k WHERE kind NOTNULL"
    )
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

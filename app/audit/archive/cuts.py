"""The cuts of a store, and the removal of what they cover."""

from __future__ import annotations

from dataclasses import astuple, fields
from typing import Any

from app.audit.archive.cut import Cut
from app.audit.proof.keyring import KeyRing
from app.database import StoreConnection
from app.database.connection import has_column
from bus.instants import UnixTime

MAX_REMOVED = 200
"""Entries that one transaction removes: a few milliseconds, so that no command waits for more."""
MAX_SCANNED = 2000
_COLUMNS = ", ".join(field.name for field in fields(Cut))
_ENTRIES = """
SELECT e.*, p.change AS part_of FROM events e LEFT JOIN event_parts p ON p.event = e.id
WHERE e.id >= ? AND e.id <= ? ORDER BY e.id LIMIT ?
"""
_STAYS = "id IN (SELECT event FROM shift_signature)"
"""The sheet of a shift is proven by the entries of its signatures, which therefore stay."""


def cuts_of(connection: StoreConnection) -> list[Cut]:
    """Every cut, oldest first; of a store of any version."""
    if not has_column(connection, "events_archive", "last"):
        return []
    return [Cut(*row) for row in connection.execute(f"SELECT {_COLUMNS} FROM events_archive ORDER BY last")]


def newest_cut(connection: StoreConnection, ring: KeyRing) -> Cut | None:
    """Where the log begins; None where nothing was archived. One that was not written with the key counts for
    nothing: then what is gone is missing."""
    cuts = cuts_of(connection)
    return cuts[-1] if cuts and cuts[-1].is_sealed(ring) else None


def add_cut(connection: StoreConnection, cut: Cut) -> None:
    """Note a cut: from now on what it covers may be removed."""
    marks = ", ".join("?" * len(fields(Cut)))
    connection.execute(f"INSERT INTO events_archive ({_COLUMNS}) VALUES ({marks})", astuple(cut))


def times_after(connection: StoreConnection, number: int) -> list[tuple[int, UnixTime]]:
    """Number and time of the next `MAX_SCANNED` entries after a number."""
    query = "SELECT id, time FROM events WHERE id > ? ORDER BY id LIMIT ?"
    return [(row[0], UnixTime(row[1])) for row in connection.execute(query, (number, MAX_SCANNED))]


def before_unfinished(connection: StoreConnection, first: int, last: int) -> int:
    """The highest number up to ``last`` at which the log can be cut without parting a command from its result
    or a change from its parts."""
    while True:
        span = (first, last, last)
        about = "SELECT min(about) FROM events WHERE about >= ? AND about <= ? AND id > ?"
        change = "SELECT min(change) FROM event_parts WHERE change >= ? AND change <= ? AND event > ?"
        found = [connection.execute(query, span).fetchone()[0] for query in (about, change)]
        parted = min((number for number in found if number is not None), default=None)
        if parted is None:
            return last
        last = parted - 1


def entries_between(connection: StoreConnection, first: int, last: int, limit: int) -> list[dict[str, Any]]:
    """Entries as they are stored; ``part_of``: the change that one is a part of."""
    return [dict(row) for row in connection.execute(_ENTRIES, (first, last, limit))]


def remove_some(connection: StoreConnection) -> bool:
    """Remove some of the entries that are archived, the newest first: a result goes before its command.
    Return whether there may be more."""
    query = (
        f"SELECT max(id) FROM events WHERE id <= (SELECT max(last) FROM events_archive) AND NOT ({_STAYS})"
    )
    [top] = connection.execute(query).fetchone()
    if top is None:
        return False
    span = (top - MAX_REMOVED, top)
    connection.execute("DELETE FROM event_parts WHERE event > ? AND event <= ?", span)
    connection.execute(f"DELETE FROM events WHERE id > ? AND id <= ? AND NOT ({_STAYS})", span)
    return True

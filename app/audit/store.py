"""The events table: appended to, read, never changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from app.audit.chain import FIELDS, Head, remark_on, sealed_entry, sealed_head
from app.audit.entry import new_entry, readable
from app.audit.keyring import KeyRing
from app.audit.keys import Keys
from app.audit.walk import AuditVerification, Walk
from app.database import StoreConnection
from app.database.engine import json_member, upsert
from bus.instants import UnixTime

_COLUMNS = (*FIELDS, "count", "messages", "key", "previous", "hash", "seal")
"""A further column must allow NULL and stand here; the hash covers it wherever it is not NULL."""
_INSERT = f"INSERT INTO events ({', '.join(_COLUMNS)}) VALUES ({', '.join('?' * len(_COLUMNS))})"
_NOTE_HEAD = upsert("events_head", ("only",), ("id", "hash", "key", "seal"))
LOWEST_ID = -(2**63)
"""Where a walk begins: an entry that was added before the first must be seen too."""
CHUNK = 500
"""Entries that are verified at a stretch: a few milliseconds."""
_FOLDED = """
SELECT e.id, e.time, e.kind, e.who, e.origin, e.bus, e.unit, e.what, e.old, e.new, e.old_raw, e.new_raw,
       COALESCE(f.outcome, e.outcome) AS outcome, COALESCE(f.message, e.message) AS message,
       COALESCE(f.frames, e.frames) AS frames, e.count, f.time AS concluded_at,
       e.messages, f.messages AS concluded_messages
FROM events e LEFT JOIN events f ON f.about = e.id
WHERE e.about IS NULL
"""
_SEARCHED = ("what", "who", "old", "new", "message")
_IN_GROUP = """
SELECT 1 FROM event_parts JOIN events change ON change.id = event_parts.change
LEFT JOIN events change_result ON change_result.about = change.id
WHERE event_parts.event = e.id
"""


@dataclass(frozen=True)
class Filter:
    """The events of a query; None or empty does not filter. Times in seconds since the epoch. ``code`` and
    ``number`` are those of the message in ``what``, which older events do not have.
    ``folded`` leaves out the parts of a change that is in the result, ``parts_of`` all but the parts of
    these."""

    before: int | None = None
    kind: str | None = None
    bus: str | None = None
    unit: int | None = None
    who: str | None = None
    since: UnixTime | None = None
    until: UnixTime | None = None
    search: str = ""
    code: str | None = None
    number: int | None = None
    old_raw: int | None = None
    new_raw: int | None = None
    folded: bool = False
    parts_of: tuple[int, ...] | None = None
    after: int | None = None

    def conditions(self, event: str = "e", conclusion: str = "f") -> tuple[str, list[Any]]:
        """SQL to append to a query, with the aliases of the events and their conclusions, and its values."""
        messages = f"{event}.messages"
        given = {
            f"{event}.id < ?": self.before,
            f"{event}.id > ?": self.after,
            f"{event}.kind = ?": self.kind,
            f"{event}.bus = ?": self.bus,
            f"{event}.unit = ?": self.unit,
            f"{event}.who = ?": self.who,
            f"{event}.time >= ?": self.since,
            f"{event}.time < ?": self.until,
            f"{event}.old_raw = ?": self.old_raw,
            f"{event}.new_raw = ?": self.new_raw,
            f"{json_member(messages, 'what.code')} = ?": self.code,
            f"{json_member(messages, 'what.params.number')} = ?": self.number,
        }
        parts = [f"AND {condition}" for condition, value in given.items() if value is not None]
        values: list[Any] = [value for value in given.values() if value is not None]
        if self.search:
            columns = (*(f"{event}.{column}" for column in _SEARCHED), f"{conclusion}.message")
            either = " OR ".join(f"{column} LIKE ? ESCAPE '!'" for column in columns)
            parts.append(f"AND ({either})")
            values += [_pattern(self.search)] * len(columns)
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


def head_of(connection: StoreConnection) -> Head:
    """The newest entry as noted apart."""
    head, _ = extent(connection)
    return head


def append(connection: StoreConnection, entry: Mapping[str, Any], keys: Keys) -> int:
    """Add an entry without its id; return the id. Where the log before it cannot be vouched for, an entry
    about that comes first."""
    head = _end_of(connection)
    ring = keys.knowing(head.key)
    if remark := remark_on(head, ring):
        head = _insert(connection, head, new_entry(kind="audit", time=entry["time"], what=remark), ring)
    return _insert(connection, head, entry, ring).id


def _end_of(connection: StoreConnection) -> Head:
    """The newest entry as noted apart, or one that is there behind it and cannot have been written so."""
    head, last = extent(connection)
    return (link_of(connection, last) if last > head.id else None) or head


def _insert(connection: StoreConnection, head: Head, entry: Mapping[str, Any], ring: KeyRing) -> Head:
    # Exactly what the row will hold: the hash of anything else would not be confirmed by it.
    row = {name: entry.get(name) for name in _COLUMNS} | {"id": head.id + 1}
    sealed = sealed_entry(head.hash, row, ring)
    connection.execute(_INSERT, [sealed.get(name) for name in _COLUMNS])
    new = sealed_head(sealed, ring)
    connection.execute(_NOTE_HEAD, (1, new.id, new.hash, new.key, new.seal))
    return new


def select(connection: StoreConnection, wanted: Filter, limit: int) -> list[dict[str, Any]]:
    """Events newest first, each command with its outcome."""
    conditions, values = wanted.conditions()
    query = f"{_FOLDED} {conditions} ORDER BY e.id DESC LIMIT ?"
    return [readable(dict(row)) for row in connection.execute(query, [*values, limit])]


def one(connection: StoreConnection, number: int) -> dict[str, Any] | None:
    """One event with its outcome."""
    row = connection.execute(f"{_FOLDED} AND e.id = ?", (number,)).fetchone()
    return readable(dict(row)) if row else None


def kinds(connection: StoreConnection) -> list[str]:
    """Every kind there is an event of, each found by one look into the index."""
    query = (
        "WITH RECURSIVE k(kind) AS (SELECT min(kind) FROM events WHERE about IS NULL UNION ALL "
        "SELECT (SELECT min(kind) FROM events WHERE about IS NULL AND kind > k.kind) FROM k "
        "WHERE kind NOTNULL) SELECT kind FROM k WHERE kind NOTNULL"
    )
    return [row["kind"] for row in connection.execute(query)]


def open_intents(connection: StoreConnection, bus: str | None) -> list[dict[str, Any]]:
    """Commands to a bus, or to none, without an outcome."""
    query = (
        "SELECT * FROM events e WHERE e.kind = 'command' AND e.about IS NULL AND e.outcome IS NULL "
        "AND NOT EXISTS (SELECT 1 FROM events f WHERE f.about = e.id) AND coalesce(e.bus, '') = ?"
    )
    return [dict(row) for row in connection.execute(query, (bus or "",))]


def extent(connection: StoreConnection) -> tuple[Head, int]:
    """The entry noted as the newest, and the number of the last one stored, at one instant."""
    row = connection.execute(
        "SELECT head.*, (SELECT max(id) FROM events) AS last FROM (SELECT 1) LEFT JOIN events_head AS head"
    ).fetchone()
    _, number, *rest, last = row
    # A store of an earlier version has no key and no seal.
    return Head() if number is None else Head(number, *rest), last or 0


def link_of(connection: StoreConnection, number: int) -> Head | None:
    """One entry as the next one continues it."""
    row = connection.execute("SELECT id, hash, key FROM events WHERE id = ?", (number,)).fetchone()
    return Head(*row) if row else None


def prove(connection: StoreConnection, ring: KeyRing, anchors: Mapping[int, str]) -> AuditVerification:
    """Walk the log, chunk by chunk: entries added in between are left for the next time."""
    head, last = extent(connection)
    walk, number = Walk(ring, anchors), LOWEST_ID
    while (following := follow_chunk(connection, walk, number, last)) is not None:
        number = following
    return walk.end(head)


def follow_chunk(connection: StoreConnection, walk: Walk, number: int, until: int) -> int | None:
    """Follow at most `CHUNK` entries from ``number`` to ``until``; return the next number or None."""
    query = "SELECT * FROM events WHERE id >= ? AND id <= ? ORDER BY id LIMIT ?"
    chunk = [dict(row) for row in connection.execute(query, (number, until, CHUNK))]
    walk.follow(chunk)
    return chunk[-1]["id"] + 1 if chunk and walk.broken is None else None

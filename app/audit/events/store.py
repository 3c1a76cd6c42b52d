"""The events table as it is read, and verified; `app.audit.events.appending` writes it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from app.audit.archive.cuts import newest_cut
from app.audit.events.entry import readable
from app.audit.proof.chain import SITE, Head
from app.audit.proof.keyring import KeyRing
from app.audit.proof.walk import AuditVerification, Walk
from app.database import StoreConnection
from app.database.connection import json_member
from bus.instants import UnixTime

LOWEST_ID = -(2**63)
"""Where a walk begins: an entry that was added before the first must be seen too."""
CHUNK = 500
"""Entries that are verified at a stretch: a few milliseconds."""
_FOLDED = """
SELECT e.id, e.time, e.kind, e.who, e.origin, e.bus, e.unit, e.what,
       COALESCE(f.old, e.old) AS old, COALESCE(f.new, e.new) AS new, e.old_raw, e.new_raw,
       COALESCE(f.outcome, e.outcome) AS outcome, COALESCE(f.message, e.message) AS message,
       COALESCE(f.frames, e.frames) AS frames, e.count, f.time AS concluded_at, e.entered_at,
       e.messages, f.messages AS concluded_messages
FROM events e LEFT JOIN events f ON f.about = e.id
WHERE e.about IS NULL
"""
_EXTENT = "SELECT * FROM (SELECT max(id) AS last FROM events) AS log LEFT JOIN events_head ON 1 = 1"
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
    """The events of a query; None or empty does not filter. Times in seconds since the epoch. ``code`` and
    ``number`` are those of the message in ``what``, which older events do not have.
    ``named``: units that ``search`` names; what is about them is found too.
    ``newest``: among so many entries of the log, the newest ones; it bounds what a search costs.
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
        """SQL to append to a query, with the aliases of the events and their conclusions, and its values."""
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


def heads_of(connection: StoreConnection) -> dict[str, Head]:
    """The newest entry of each chain as noted apart, by chain; of a store of any version."""
    heads, _ = extent(connection)
    return heads


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
        "WHERE kind IS NOT NULL) SELECT kind FROM k WHERE kind IS NOT NULL"
    )
    return [row["kind"] for row in connection.execute(query)]


def open_intents(connection: StoreConnection, bus: str | None) -> list[dict[str, Any]]:
    """Commands to a bus, or to none, without an outcome."""
    # By the index of the bus: all buses together read each event once.
    place = "e.bus IS NULL" if bus is None else "e.bus = ?"
    query = (
        f"SELECT * FROM events e WHERE {place} AND e.kind = 'command' AND e.about IS NULL"
        " AND e.outcome IS NULL "
        "AND NOT EXISTS (SELECT 1 FROM events f WHERE f.about = e.id)"
    )
    return [dict(row) for row in connection.execute(query, () if bus is None else (bus,))]


def extent(connection: StoreConnection) -> tuple[dict[str, Head], int]:
    """The newest entry of each chain as noted apart, and the number of the last one stored, of one
    instant."""
    rows = [dict(row) for row in connection.execute(_EXTENT)]
    # A store of an earlier version has one chain, and at first no key and no seal.
    heads = [
        Head(row["id"], row["hash"], row.get("key", ""), row.get("seal", ""), row.get("chain", SITE))
        for row in rows
        if row["id"] is not None
    ]
    return {head.chain: head for head in heads}, rows[0]["last"] or 0


def links_of(connection: StoreConnection, heads: Mapping[str, Head], ring: KeyRing) -> dict[str, Head]:
    """The entries that heads name, by chain, each as the next one continues it; without those that are gone.
    Of a chain whose entry is archived, its end where the log was cut."""
    query = "SELECT id, hash, key FROM events WHERE id = ?"
    cut = newest_cut(connection, ring)
    links = dict(cut.ends) if cut else {}
    there = {}
    for chain, head in heads.items():
        row = connection.execute(query, (head.id,)).fetchone()
        if cut and head.id <= cut.last and chain in links:
            there[chain] = links[chain]
        elif row is not None:
            there[chain] = Head(*row)
    return there


def walk_from_cut(
    connection: StoreConnection, ring: KeyRing, anchors: Mapping[int, Head] | None = None
) -> Walk:
    """A walk over the entries of a store, from where the log was cut."""
    cut = newest_cut(connection, ring)
    return Walk(ring, anchors) if cut is None else Walk(ring, anchors, cut.ends, cut.last)


def prove(connection: StoreConnection, ring: KeyRing, anchors: Mapping[int, Head]) -> AuditVerification:
    """Walk the log, chunk by chunk: entries added in between are left for the next time."""
    heads, last = extent(connection)
    walk, number = walk_from_cut(connection, ring, anchors), LOWEST_ID
    while (following := follow_chunk(connection, walk, number, last)) is not None:
        number = following
    return walk.end(heads)


def follow_chunk(connection: StoreConnection, walk: Walk, number: int, until: int) -> int | None:
    """Follow at most `CHUNK` entries from ``number`` to ``until``; return the next number or None."""
    query = "SELECT * FROM events WHERE id >= ? AND id <= ? ORDER BY id LIMIT ?"
    chunk = [dict(row) for row in connection.execute(query, (number, until, CHUNK))]
    walk.follow(chunk)
    return chunk[-1]["id"] + 1 if chunk else None

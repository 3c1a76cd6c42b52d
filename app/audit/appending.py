"""Appending to the events: an entry continues the chain of its bus, or that of the site.

The numbers of entries ascend over all chains without a gap, so that one that is gone is missed whatever chain
it was of. One transaction appends at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from app.audit.chain import (
    END_ALTERED,
    FIELDS,
    ROTATED,
    SITE,
    Head,
    newest_of,
    remark_on,
    sealed_entry,
    sealed_head,
)
from app.audit.entry import new_entry
from app.audit.keys import Keys
from app.database import StoreConnection
from app.database.engine import lock, upsert
from bus.instants import UnixTime
from bus.messages import Message

_COLUMNS = (*FIELDS, "count", "messages", "chain", "key", "previous", "hash", "seal")
"""A further column must allow NULL and stand here; the hash covers it wherever it is not NULL."""
_INSERT = f"INSERT INTO events ({', '.join(_COLUMNS)}) VALUES ({', '.join('?' * len(_COLUMNS))})"
_NOTE_HEAD = upsert("events_head", ("chain",), ("id", "hash", "key", "seal"))
_HEADS = "SELECT id, hash, key, seal, chain FROM events_head"
_LAST = "SELECT id, hash, key, chain FROM events ORDER BY id DESC LIMIT 1"


def append(connection: StoreConnection, entries: Sequence[Mapping[str, Any]], keys: Keys) -> list[int]:
    """Add entries without their ids; return the ids. Where a chain before them cannot be vouched for, an
    entry about that comes first."""
    lock(connection, "events")
    chains = [_chain_of(connection, entry) for entry in entries]
    end = _LogEnd(connection, {*chains, SITE}, keys)
    if entries:
        end.take_newest_key(entries[0]["time"], chains)
    numbers = [end.add(chain, entry) for chain, entry in zip(chains, entries, strict=True)]
    end.note()
    return numbers


def _chain_of(connection: StoreConnection, entry: Mapping[str, Any]) -> str:
    """The bus of an entry, or of the command that it concludes."""
    bus = entry.get("bus")
    if bus is None and entry.get("about") is not None:
        row = connection.execute("SELECT bus FROM events WHERE id = ?", (entry["about"],)).fetchone()
        bus = row[0] if row else None
    return bus or SITE


class _LogEnd:
    """The ends of the chains of one transaction, as they are continued. `note` stores them."""

    def __init__(self, connection: StoreConnection, chains: set[str], keys: Keys) -> None:
        self._connection = connection
        marks = ", ".join("?" * len(chains))
        newest_too = f"{_HEADS} WHERE chain IN ({marks}) OR id = (SELECT max(id) FROM events_head)"
        self._heads = _heads(connection.execute(newest_too, [*chains]))
        newest = newest_of(self._heads.values())
        last = connection.execute(_LAST).fetchone()
        self._number = max(newest.id, last[0] if last else 0)
        self._newest_key = newest.key
        self._ring = keys.knowing(newest.key)
        self._is_altered = self._number > newest.id
        if last and self._is_altered:
            # It is there behind the noted ends, and cannot have been written so.
            number, digest, key, chain = last
            self._heads[chain or SITE] = Head(number, digest, key, chain=chain or SITE)
        self._changed: set[str] = set()

    def take_newest_key(self, time: UnixTime, chains: Iterable[str]) -> None:
        """Where a newer key is used for the first time, seal every chain with it: else one who knows an older
        key could rewrite a chain in which nothing follows. ``chains`` are continued anyway."""
        if self._ring.rank(self._newest_key) is None or self._newest_key == self._ring.newest:
            return
        self._heads = _heads(self._connection.execute(_HEADS)) | self._heads
        for chain in sorted(self._heads.keys() - set(chains)):
            self.add(chain, new_entry(kind="audit", time=time, what=ROTATED, bus=chain or None))

    def add(self, chain: str, entry: Mapping[str, Any]) -> int:
        """Add an entry without its id to a chain; return the id."""
        continued = chain if chain in self._heads else SITE
        if remark := self._remark_on(continued):
            about = new_entry(kind="audit", time=entry["time"], what=remark, bus=continued or None)
            self._insert(continued, about)
        return self._insert(chain, entry)

    def note(self) -> None:
        """Store the ends of the chains that were continued."""
        for chain in self._changed:
            head = self._heads[chain]
            self._connection.execute(_NOTE_HEAD, (chain, head.id, head.hash, head.key, head.seal))

    def _remark_on(self, chain: str) -> Message | None:
        remark = None if chain in self._changed else remark_on(self._heads.get(chain, Head()), self._ring)
        if remark is None and self._is_altered:
            remark = END_ALTERED
        self._is_altered = False
        return remark

    def _insert(self, chain: str, entry: Mapping[str, Any]) -> int:
        before = self._heads.get(chain) or self._heads.get(SITE) or Head()
        self._number += 1
        # Exactly what the row will hold: the hash of anything else would not be confirmed by it.
        row = {name: entry.get(name) for name in _COLUMNS} | {"id": self._number, "chain": chain}
        sealed = sealed_entry(before.hash, row, self._ring)
        self._connection.execute(_INSERT, [sealed.get(name) for name in _COLUMNS])
        for continued in {chain} if chain in self._heads else {chain, SITE}:
            self._heads[continued] = sealed_head(sealed, self._ring, continued)
            self._changed.add(continued)
        return self._number


def _heads(rows: Iterable[Sequence[Any]]) -> dict[str, Head]:
    return {row[4]: Head(*row) for row in rows}

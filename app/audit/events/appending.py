"""Appending to the events: an entry continues the chain of its bus, or that of the site.

The numbers of entries ascend over all chains without a gap, so that one that is gone is missed whatever chain
it was of. One transaction appends at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from app.audit.events.entry import new_entry
from app.audit.proof.chain import (
    END_ALTERED,
    FIELDS,
    ROTATED,
    SITE,
    Head,
    remark_on,
    sealed_entry,
    sealed_head,
)
from app.audit.proof.keys import Keys
from app.database import StoreConnection
from app.database.connection import upsert
from bus.instants import UnixTime
from bus.messages import Message

_COLUMNS = (*FIELDS, "count", "messages", "entered_at", "chain", "key", "previous", "hash", "seal")
"""A further column must allow NULL and stand here; the hash covers it wherever it is not NULL."""
_INSERT = f"INSERT INTO events ({', '.join(_COLUMNS)}) VALUES ({', '.join('?' * len(_COLUMNS))})"
_NOTE_HEAD = upsert("events_head", ("chain",), ("id", "hash", "key", "seal"))
_HEADS = "SELECT id, hash, key, seal, chain FROM events_head"
_HEAD = f"{_HEADS} WHERE chain = ?"
_LAST = """
SELECT last.id, last.hash, last.key, COALESCE(last.chain, ''),
       head.id, head.hash, head.key, head.seal, head.chain
FROM events AS last LEFT JOIN events_head AS head ON head.chain = COALESCE(last.chain, '')
ORDER BY last.id DESC LIMIT 1
"""
"""The last entry, and the noted end of its chain."""
_NO_ENTRY = (0, "", "", SITE, *[None] * 5)


def append(connection: StoreConnection, entries: Sequence[Mapping[str, Any]], keys: Keys) -> list[int]:
    """Add entries without their ids; return the ids. Where a chain before them cannot be vouched for, an
    entry about that comes first."""
    end = _LogEnd(connection, keys)
    chains = [_chain_of(connection, entry) for entry in entries]
    if entries and end.is_first_use_of_key:
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
    """The ends of the chains as one transaction continues them. `note` stores them."""

    def __init__(self, connection: StoreConnection, keys: Keys) -> None:
        self._connection = connection
        self._heads: dict[str, Head | None] = {}
        self._changed: set[str] = set()
        found: Sequence[Any] = connection.execute(_LAST).fetchone() or _NO_ENTRY
        number, digest, key, chain, *noted = found
        self._number: int = max(0, number)
        end = Head(*noted) if noted[0] else self._head(chain)
        self._is_altered = number > (end.id if end else 0)
        if self._is_altered:
            # It is there behind the noted end, and cannot have been written so.
            end = Head(number, digest, key, chain=chain)
        self._heads[chain] = end
        newest_key = end.key if end else ""
        self._ring = keys.knowing(newest_key)
        self.is_first_use_of_key = self._ring.rank(newest_key) not in (None, len(self._ring.keys) - 1)

    def take_newest_key(self, time: UnixTime, chains: Iterable[str]) -> None:
        """Where a newer key is used for the first time, seal every chain with it: else one who knows an older
        key could rewrite a chain in which nothing follows. ``chains`` are continued anyway."""
        for row in self._connection.execute(_HEADS).fetchall():
            self._heads.setdefault(row[4], Head(*row))
        begun = {chain for chain, head in self._heads.items() if head is not None}
        for chain in sorted(begun - set(chains)):
            self.add(chain, new_entry(kind="audit", time=time, what=ROTATED, bus=chain or None))

    def add(self, chain: str, entry: Mapping[str, Any]) -> int:
        """Add an entry without its id to a chain; return the id."""
        continued = SITE if self._head(chain) is None else chain
        if remark := self._remark_on(continued):
            about = new_entry(kind="audit", time=entry["time"], what=remark, bus=continued or None)
            self._insert(continued, about)
        return self._insert(chain, entry)

    def note(self) -> None:
        """Store the ends of the chains that were continued."""
        for chain in self._changed:
            if head := self._heads[chain]:
                self._connection.execute(_NOTE_HEAD, (chain, head.id, head.hash, head.key, head.seal))

    def _head(self, chain: str) -> Head | None:
        """The end of a chain, None where it has not begun."""
        if chain not in self._heads:
            row = self._connection.execute(_HEAD, (chain,)).fetchone()
            self._heads[chain] = Head(*row) if row else None
        return self._heads[chain]

    def _remark_on(self, chain: str) -> Message | None:
        if chain in self._changed:
            return None
        head = self._head(chain)
        remark = remark_on(head, self._ring) if head else None
        if remark is None and self._is_altered:
            remark = END_ALTERED
        self._is_altered = False
        return remark

    def _insert(self, chain: str, entry: Mapping[str, Any]) -> int:
        own = self._head(chain)
        before = own or self._head(SITE) or Head()
        self._number = max(self._number, before.id) + 1
        # Exactly what the row will hold: the hash of anything else would not be confirmed by it.
        row = {name: entry.get(name) for name in _COLUMNS}
        row["id"], row["chain"] = self._number, chain
        sealed = sealed_entry(before.hash, row, self._ring)
        self._connection.execute(_INSERT, [sealed[name] for name in _COLUMNS])
        for continued in (chain,) if own else {chain, SITE}:
            self._heads[continued] = sealed_head(sealed, self._ring, continued)
            self._changed.add(continued)
        return self._number

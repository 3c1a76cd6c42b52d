"""The proof that the log of a store is as it was written, from its beginning or from where it was cut."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import astuple, dataclass, fields, replace
from functools import partial
from typing import Annotated, Any

import msgspec
from pydantic import ConfigDict, Field

from app.core.database import Database, StoreConnection
from app.core.database.connection import has_column, open_for_reading
from app.core.database.files import in_words
from app.core.lifespan import in_thread
from app.core.web.shape import MessageObject
from app.people.audit.entry import (
    SITE,
    Ends,
    Head,
    KeyRing,
    advance,
    confirms_head,
    entry_hash,
    expected_previous,
    is_sound_alone,
    newest_of,
    notes_altered_end,
)
from app.people.audit.keys import Keys
from bus.instants import UnixTime
from bus.messages import Message

LOWEST_ID = -(2**63)
"""The id at which a walk begins, so that it also meets an entry that was added before the first one."""
CHUNK = 500
"""The entries that are verified at a time, which takes a few milliseconds."""


@dataclass(frozen=True)
class AuditVerification:
    """The result of verifying the log. Entries older than the key are only verified to be as they were when
    it was made."""

    entries: int
    broken: Annotated[int | None, Field(description="Number of the first broken entry; null: none.")] = None
    fault: Annotated[MessageObject | None, Field(description="Why it is not intact; null: it is.")] = None
    unsealed: Annotated[int, Field(description="Entries up to this one are older than the key; 0: none.")] = 0
    anchored: Annotated[int, Field(description="The newest entry that the anchor names; 0: none.")] = 0
    archived: Annotated[
        int, Field(description="Entries up to this one are in the archive, not verified here; 0: none.")
    ] = 0

    __pydantic_config__ = ConfigDict(json_schema_serialization_defaults_required=True)


class Walk:
    """A walk along a log up to its first broken entry, from its beginning or from ends that are known to be
    good. ``anchors``: hashes that were noted elsewhere, by entry; ``archived``: entries up to this number are
    in the archive, and each of those that are left in the store is verified on its own. Pure."""

    def __init__(
        self,
        ring: KeyRing,
        anchors: Mapping[int, str] | None = None,
        start: Ends | None = None,
        archived: int = 0,
    ) -> None:
        self._ring = ring
        self._archived = archived
        self._anchors = {number: hash_ for number, hash_ in (anchors or {}).items() if number > archived}
        self.ends = dict(start or {})
        """The last entry of each chain so far."""
        self._number = newest_of(self.ends.values()).id
        ranks = (ring.rank(head.key) for head in self.ends.values())
        self._rank = max((rank for rank in ranks if rank is not None), default=0)
        self._broken = 0
        self.fault: Message | None = None
        """The reason why the entries so far are not intact; None if they are."""

    def follow(self, entries: Iterable[Mapping[str, Any]]) -> None:
        """Verify the next entries in order, up to the first broken one."""
        for entry in entries:
            if self.fault is not None:
                return
            number = entry["id"]
            if 0 < number <= self._archived:
                if not is_sound_alone(entry, self._ring):
                    self._break(number, "audit_entry_changed", entry=number)
            elif number > self._number + 1:
                missing = self._number + 1
                self._break(missing, "audit_entry_missing", entry=missing, before=self._number, found=number)
            elif code := self._fault_of(entry):
                self._break(number, code, entry=number)
            else:
                advance(self.ends, entry)
                self._number = number

    def end(self, heads: Ends) -> AuditVerification:
        """Return the result after the last entry; ``heads``: the entries that were noted apart as the
        newest."""
        if self.fault is None:
            self._check_end(heads)
        if self.fault is not None:
            return AuditVerification(self._number, self._broken, self.fault, archived=self._archived)
        unsealed, anchored = min(self._number, self._ring.origin.id), max(self._anchors, default=0)
        return AuditVerification(self._number, unsealed=unsealed, anchored=anchored, archived=self._archived)

    def _fault_of(self, entry: Mapping[str, Any]) -> str:
        number, previous = entry["id"], expected_previous(entry, self.ends)
        if number != self._number + 1 or entry.get("previous") != previous:
            return "audit_entry_apart"
        if entry.get("hash") != entry_hash(previous, entry):
            return "audit_entry_changed"
        if self._anchors.get(number, entry["hash"]) != entry["hash"]:
            return "audit_entry_not_anchored"
        return self._fault_of_seal(entry)

    def _fault_of_seal(self, entry: Mapping[str, Any]) -> str:
        number, key, origin = entry["id"], entry.get("key") or "", self._ring.origin
        if number <= origin.id:
            is_noted = origin.hashes.get(number, entry["hash"]) == entry["hash"]
            return "" if is_noted else "audit_entry_not_original"
        rank = self._ring.rank(key)
        if rank is None:
            return "audit_entry_without_key"
        if rank < self._rank:
            return "audit_entry_older_key"
        if not self._ring.confirms(entry.get("seal") or "", key, "entry", entry["hash"]):
            return "audit_entry_not_sealed"
        if notes_altered_end(entry):
            return "audit_entry_notes_alteration"
        self._rank = rank
        return ""

    def _check_end(self, heads: Ends) -> None:
        last, written, origin = self._number, newest_of(heads.values()).id, self._ring.origin.id
        named = max(self._anchors, default=0)
        if last < written:
            self._break(last + 1, "audit_end_before_newest", entry=last, written=written)
        for chain, end in self.ends.items():
            head = heads.get(chain, Head())
            if (end.id, end.hash) != (head.id, head.hash):
                self._break(end.id, "audit_entry_not_newest", entry=end.id)
            elif end.id > origin and not confirms_head(head, self._ring):
                self._break(end.id, "audit_end_not_sealed", entry=end.id)
            elif end.id > origin and end.key != self._ring.newest:
                self._break(last + 1, "audit_newest_key_unused")
        if last < named:
            self._break(last + 1, "audit_end_before_anchor", entry=last, named=named)
        if last < origin:
            self._break(last + 1, "audit_end_before_key", entry=last, written=origin)

    def _break(self, number: int, code: str, **params: int) -> None:
        if self.fault is None:
            self._broken, self.fault = number, Message.of(code, **params)


@dataclass(frozen=True, slots=True)
class Cut:
    """A cut of the log: entries ``first`` to ``last`` are in ``file`` of the archive, whose SHA-256 is
    ``digest``. ``heads``: JSON of the ends of the chains at ``last``, which the remaining entries continue;
    ``first_hash``: that of the first entry of the log, in a cut of 0.2; ``at``: when it was made."""

    last: int
    first: int
    file: str
    digest: str
    first_hash: str
    heads: str
    at: UnixTime
    key: str = ""
    seal: str = ""

    @property
    def ends(self) -> dict[str, Head]:
        """The ends of the chains at ``last``, by chain."""
        ends = msgspec.json.decode(self.heads, type=dict[str, tuple[int, str, str]])
        return {chain: Head(*end, chain=chain) for chain, end in ends.items()}

    def sealed(self, ring: KeyRing) -> Cut:
        """Return this cut sealed with the newest key."""
        return replace(self, key=ring.newest, seal=ring.seal("cut", *self._sealed_parts))

    def is_sealed(self, ring: KeyRing) -> bool:
        """Return whether the cut was written with a key of the ring."""
        return ring.confirms(self.seal, self.key, "cut", *self._sealed_parts)

    @property
    def _sealed_parts(self) -> tuple[str, ...]:
        at = repr(float(self.at))
        return str(self.last), str(self.first), self.file, self.digest, self.first_hash, at, self.heads


def heads_text(ends: Ends) -> str:
    """Return the ends of chains in the form of `Cut.heads`."""
    plain = {chain: (head.id, head.hash, head.key) for chain, head in sorted(ends.items())}
    return msgspec.json.encode(plain).decode()


_CUT = ", ".join(field.name for field in fields(Cut))


def cuts_of(connection: StoreConnection) -> list[Cut]:
    """Return all cuts of a store of any version, oldest first."""
    if not has_column(connection, "events_archive", "last"):
        return []
    return [Cut(*row) for row in connection.execute(f"SELECT {_CUT} FROM events_archive ORDER BY last")]


def newest_cut(connection: StoreConnection, ring: KeyRing) -> Cut | None:
    """Return the cut at which the log begins, None if nothing was archived. A cut that was not written with
    the key does not count, and the entries before it are then missing."""
    cuts = cuts_of(connection)
    return cuts[-1] if cuts and cuts[-1].is_sealed(ring) else None


def add_cut(connection: StoreConnection, cut: Cut) -> None:
    """Store a cut: from now on the entries that it covers may be removed."""
    marks = ", ".join("?" * len(fields(Cut)))
    connection.execute(f"INSERT INTO events_archive ({_CUT}) VALUES ({marks})", astuple(cut))


def heads_of(connection: StoreConnection) -> dict[str, Head]:
    """Return the entry of each chain that was noted apart as its newest, of a store of any version."""
    heads, _ = extent(connection)
    return heads


def extent(connection: StoreConnection) -> tuple[dict[str, Head], int]:
    """Return the entries that were noted apart as the newest, and the number of the last stored one, both of
    one instant."""
    query = "SELECT * FROM (SELECT max(id) AS last FROM events) AS log LEFT JOIN events_head ON 1 = 1"
    rows = [dict(row) for row in connection.execute(query)]
    # A store of an earlier version has one chain, and at first no key and no seal.
    heads = [
        Head(row["id"], row["hash"], row.get("key", ""), row.get("seal", ""), row.get("chain", SITE))
        for row in rows
        if row["id"] is not None
    ]
    return {head.chain: head for head in heads}, rows[0]["last"] or 0


def prove(
    connection: StoreConnection, ring: KeyRing, anchors: Mapping[int, str], known: Head | None = None
) -> AuditVerification:
    """Verify the log up to the entry that is the last one now, and that it has the hashes of ``anchors``, by
    entry. With ``known`` only the part after that entry, if the log has it. It reads chunk by chunk, so that
    the store's checkpoint does not wait for a long log; if entries were archived meanwhile, it begins again
    from the new cut."""
    while True:
        cuts = cuts_of(connection)
        proof = _followed(connection, ring, anchors, known)
        if proof.fault is None or cuts_of(connection) == cuts:
            return proof


def _followed(
    connection: StoreConnection, ring: KeyRing, anchors: Mapping[int, str], known: Head | None
) -> AuditVerification:
    heads, last = extent(connection)
    walk, number = _begun(connection, ring, anchors, known)
    query = "SELECT * FROM events WHERE id >= ? AND id <= ? ORDER BY id LIMIT ?"
    while chunk := [dict(row) for row in connection.execute(query, (number, last, CHUNK))]:
        walk.follow(chunk)
        if walk.fault is not None:
            break
        number = chunk[-1]["id"] + 1
    return walk.end(heads)


def _begun(
    connection: StoreConnection, ring: KeyRing, anchors: Mapping[int, str], known: Head | None
) -> tuple[Walk, int]:
    """Return a walk and the number of its first entry: over the complete log unless it has the entry
    ``known``, from which it then continues as a single chain."""
    if known is not None:
        query = "SELECT id, hash, key, chain FROM events WHERE id = ?"
        row = connection.execute(query, (known.id,)).fetchone()
        if row is not None and row["hash"] == known.hash and row["chain"] is None:
            return Walk(ring, start={SITE: Head(row["id"], row["hash"], row["key"])}), known.id + 1
        anchors = {known.id: known.hash} if known.id else {}
    cut = newest_cut(connection, ring)
    walk = Walk(ring, anchors) if cut is None else Walk(ring, anchors, cut.ends, cut.last)
    return walk, LOWEST_ID


class LogProof:
    """The proof of the log of a running server, in a thread that does not delay the server's end."""

    def __init__(self, database: Database, keys: Keys) -> None:
        self._database = database
        self._keys = keys
        self._one_at_a_time = asyncio.Lock()

    async def verify(self, anchors: Mapping[int, str] | None = None) -> AuditVerification:
        """Verify the complete log, and that it has the hashes of ``anchors``, by entry."""
        async with self._one_at_a_time:
            return await in_thread(partial(self._prove, anchors or {}))

    async def since(self, known: Head) -> AuditVerification:
        """Verify that the log has the entry ``known``, which the anchor names, and the part after it."""
        return await in_thread(partial(self._prove, {}, known))

    async def heads(self) -> dict[str, Head]:
        """Return the entries that were noted apart as the newest, by chain."""
        return await self._database.read(heads_of)

    def _prove(self, anchors: Mapping[int, str], known: Head | None = None) -> AuditVerification:
        path = self._database.path
        with in_words(path), closing(open_for_reading(path)) as connection:
            ring = self._keys.knowing(newest_of(heads_of(connection).values()).key)
            return prove(connection, ring, anchors, known)

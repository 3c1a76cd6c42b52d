"""The chains that make the log provable: an entry's hash covers the one before and all of the entry's fields,
and a seal over that hash shows that it was made with the key. Pure.

Each bus has a chain, and the site one; the numbers of entries ascend without a gap over all of them. The
chain of a bus branches off that of the site: its first entry is an entry of both.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from app.audit.events.entry import messages_of
from app.audit.proof.keyring import BEGINNING, KeyOrigin, KeyRing
from bus.messages import Message

FIELDS = (
    *("id", "time", "kind", "about", "who", "origin", "bus", "unit"),
    *("what", "old", "new", "old_raw", "new_raw", "outcome", "message", "frames"),
)
"""The fields that the hash of an entry without a key covers, as versions before the key wrote it."""
SITE = ""
"""The chain of the site, which has the events without a bus."""
SEALED_FROM_HERE = Message("event_audit_sealed")
OTHER_KEY = Message("event_audit_other_key")
ROTATED = Message("event_audit_key_rotated")
END_ALTERED = Message("event_audit_end_altered")
"""No failure of the machine causes this: an entry and the seal of the end are written in one transaction."""
_END_ALTERED_TEXT = "the end of the audit log was altered before this entry"
"""The text of that remark in an entry of a version that kept texts alone."""
_canonical = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False, default=str).encode
_DERIVED = frozenset({"hash", "seal"})


@dataclass(frozen=True)
class Head:
    """The newest entry of a chain, and its seal as such; ``key`` empty: no key was used yet."""

    id: int = 0
    hash: str = BEGINNING
    key: str = ""
    seal: str = ""
    chain: str = SITE


def newest_of(heads: Iterable[Head]) -> Head:
    """The newest entry of all chains; number 0 where there is none."""
    return max(heads, key=lambda head: head.id, default=Head())


def origin_of(heads: Mapping[str, Head]) -> KeyOrigin:
    """The ends of the chains as those before a first key that is made now."""
    newest = newest_of(heads.values())
    others = ((name, head.id, head.hash) for name, head in heads.items() if head is not newest)
    return KeyOrigin(newest.id, newest.hash, tuple(sorted(others)))


def entry_hash(previous: str, entry: Mapping[str, Any]) -> str:
    """SHA-256, in hex, over the previous hash and the entry as JSON with sorted keys.

    An entry with a key is covered in every column that is not NULL, also in those of later versions.
    """
    covered = {name: value for name, value in entry.items() if value is not None and name not in _DERIVED}
    if not entry.get("key"):
        newer = covered.keys() - {*FIELDS, "previous", "key"}
        covered = {name: entry.get(name) for name in FIELDS} | {name: covered[name] for name in newer}
    return hashlib.sha256(f"{previous}\n{_canonical(covered)}".encode("utf-8", "surrogatepass")).hexdigest()


def sealed_entry(previous: str, entry: Mapping[str, Any], ring: KeyRing) -> dict[str, Any]:
    """``entry``, which has its id, chained to the hash before and sealed with the newest key."""
    sealed = {**entry, "previous": previous, "key": ring.newest}
    sealed["hash"] = digest = entry_hash(previous, sealed)
    sealed["seal"] = ring.seal("entry", digest)
    return sealed


def is_sound_alone(entry: Mapping[str, Any], ring: KeyRing) -> bool:
    """Whether an entry is as it was written, whatever was before it; of one that is older than the key only
    that it fits its hash."""
    digest = entry_hash(entry.get("previous") or "", entry)
    if entry.get("hash") != digest:
        return False
    seal, key = entry.get("seal") or "", entry.get("key") or ""
    return entry["id"] <= ring.origin.id or ring.confirms(seal, key, "entry", digest)


def sealed_head(entry: Mapping[str, Any], ring: KeyRing, chain: str = SITE) -> Head:
    """A sealed entry as the newest of a chain."""
    number, digest = entry["id"], entry["hash"]
    return Head(number, digest, ring.newest, ring.seal("head", *_head_parts(number, digest, chain)), chain)


def _head_parts(number: int, digest: str, chain: str) -> tuple[str, ...]:
    """What the seal of a head covers; of the site's chain without the name, as versions with one chain had
    it."""
    return (str(number), digest, chain) if chain else (str(number), digest)


def confirms_head(head: Head, ring: KeyRing) -> bool:
    """Whether ``head`` was noted with a key of the ring."""
    return ring.confirms(head.seal, head.key, "head", *_head_parts(head.id, head.hash, head.chain))


def remark_on(head: Head, ring: KeyRing) -> Message | None:
    """An entry about the chain itself, needed before anything is added to ``head``; mostly none."""
    if head.id == 0 or confirms_head(head, ring):
        return None
    if not head.key:
        return SEALED_FROM_HERE
    return OTHER_KEY if ring.rank(head.key) is None else END_ALTERED


def notes_altered_end(entry: Mapping[str, Any]) -> bool:
    """Whether the entry is the remark :data:`END_ALTERED`."""
    if entry["kind"] != "audit":
        return False
    what = (messages_of(entry.get("messages")) or {}).get("what")
    return entry["what"] == _END_ALTERED_TEXT if what is None else what == END_ALTERED

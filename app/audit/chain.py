"""The chain that makes the log provable: an entry's hash covers the one before and all of the entry's fields,
and a seal over that hash shows that it was made with the key. Pure."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from app.audit.entry import messages_of
from app.audit.keyring import BEGINNING, KeyRing
from bus.messages import Message

FIELDS = (
    *("id", "time", "kind", "about", "who", "origin", "bus", "unit"),
    *("what", "old", "new", "old_raw", "new_raw", "outcome", "message", "frames"),
)
"""The fields that the hash of an entry without a key covers, as versions before the key wrote it."""
SEALED_FROM_HERE = Message("event_audit_sealed")
OTHER_KEY = Message("event_audit_other_key")
END_ALTERED = Message("event_audit_end_altered")
"""No failure of the machine causes this: an entry and the seal of the end are written in one transaction."""
_END_ALTERED_TEXT = "the end of the audit log was altered before this entry"
"""The text of that remark in an entry of a version that kept texts alone."""
_DERIVED = frozenset({"hash", "seal"})


@dataclass(frozen=True)
class Head:
    """The newest entry of a log, and its seal as such; ``key`` empty: no key was used yet."""

    id: int = 0
    hash: str = BEGINNING
    key: str = ""
    seal: str = ""


def entry_hash(previous: str, entry: Mapping[str, Any]) -> str:
    """SHA-256, in hex, over the previous hash and the entry as JSON with sorted keys.

    An entry with a key is covered in every column that is not NULL, also in those of later versions.
    """
    covered = {name: value for name, value in entry.items() if value is not None and name not in _DERIVED}
    if not entry.get("key"):
        newer = covered.keys() - {*FIELDS, "previous", "key"}
        covered = {name: entry.get(name) for name in FIELDS} | {name: covered[name] for name in newer}
    canonical = json.dumps(covered, sort_keys=True, separators=(",", ":"), ensure_ascii=False, default=str)
    return hashlib.sha256(f"{previous}\n{canonical}".encode("utf-8", "surrogatepass")).hexdigest()


def sealed_entry(previous: str, entry: Mapping[str, Any], ring: KeyRing) -> dict[str, Any]:
    """``entry``, which has its id, chained to the hash before and sealed with the newest key."""
    chained = {**entry, "previous": previous, "key": ring.newest}
    digest = entry_hash(previous, chained)
    return {**chained, "hash": digest, "seal": ring.seal("entry", digest)}


def sealed_head(entry: Mapping[str, Any], ring: KeyRing) -> Head:
    """A sealed entry as the newest of the log."""
    seal = ring.seal("head", str(entry["id"]), entry["hash"])
    return Head(entry["id"], entry["hash"], ring.newest, seal)


def confirms_head(head: Head, ring: KeyRing) -> bool:
    """Whether ``head`` was noted with a key of the ring."""
    return ring.confirms(head.seal, head.key, "head", str(head.id), head.hash)


def remark_on(head: Head, ring: KeyRing) -> Message | None:
    """An entry about the log itself, needed before anything is added to ``head``; mostly none."""
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

"""The chain that makes the log provable: an entry's hash covers the one before and all it says."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

BEGINNING = "0" * 64
"""What stands for the hash before the first entry."""

FIELDS = (
    *("id", "time", "kind", "about", "who", "origin", "bus", "unit"),
    *("what", "old", "new", "old_raw", "new_raw", "outcome", "message", "frames"),
)
"""What an entry's hash covers, in the order of the columns."""


@dataclass(frozen=True)
class Head:
    """The newest entry of a log."""

    id: int = 0
    hash: str = BEGINNING


@dataclass(frozen=True)
class Verdict:
    """Whether a log is whole; ``broken`` is the first entry that is not, ``fault`` says how."""

    entries: int
    broken: int | None = None
    fault: str = ""


def entry_hash(previous: str, entry: Mapping[str, Any]) -> str:
    """SHA-256, in hex, over the previous hash and the entry as JSON with sorted keys."""
    said = {name: entry[name] for name in FIELDS}
    canonical = json.dumps(said, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(f"{previous}\n{canonical}".encode()).hexdigest()


def verify(entries: Iterable[Mapping[str, Any]], head: Head | None) -> Verdict:
    """Walk a log from its beginning and compare its end with what was noted apart."""
    last = Head()
    for entry in entries:
        fault = _fault(last, entry)
        if fault:
            return Verdict(last.id, last.id + 1, fault)
        last = Head(entry["id"], entry["hash"])
    return _end(last, head or Head())


def _fault(last: Head, entry: Mapping[str, Any]) -> str:
    if entry["id"] != last.id + 1:
        return f"entry {last.id + 1} is missing; after {last.id} comes {entry['id']}"
    if entry["previous"] != last.hash:
        return f"entry {entry['id']} does not continue the one before it"
    if entry["hash"] != entry_hash(last.hash, entry):
        return f"entry {entry['id']} was changed after it was written"
    return ""


def _end(last: Head, head: Head) -> Verdict:
    if last.id < head.id:
        return Verdict(last.id, last.id + 1, f"the log ends at entry {last.id}, but {head.id} were written")
    if last != head:
        return Verdict(last.id, last.id, f"entry {last.id} is not the one that was noted as the newest")
    return Verdict(last.id)

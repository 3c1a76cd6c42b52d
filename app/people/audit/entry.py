"""An entry of the log as it is stored and read back, the chain that makes the log provable, and the keys that
seal it. Pure.

Every field has the type in which the store returns it, since the hash over the written values is compared
with one over those read. Any row can be shown, whatever it holds.

Entries are numbered without a gap. Each holds the SHA-256 of the entry before it and of all its own fields,
and a seal over that hash (HMAC-SHA256, FIPS 198-1) with a key that is not in the store. The newest entry is
noted and sealed apart, so that a log that is cut off at its end is noticed.

Version 0.2 had a chain for each bus beside that of the site. The column ``chain`` of an entry tells them
apart: NULL in the one chain of today and of versions before 0.2, "" in that of the site, else the bus.
Numbers ascend over all of them without a gap. The chain of a bus branches off that of the site: its first
entry is an entry of both. The first entry of the one chain that follows seals the ends of all former ones:
its ``previous`` is a hash over them.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import msgspec

from bus.contract import Frame
from bus.instants import UnixTime
from bus.messages import LIST, NUMBER, TERM, TEXTS, Message

Event = dict[str, Any]
"""An event with its result, as :func:`readable` returns it."""
EventKind = Literal[
    "access_refused",
    "alarm",
    "audit",
    "block",
    "bus",
    "clock",
    "command",
    "configuration",
    "control",
    "estop",
    "home",
    "limits",
    "login",
    "notification",
    "login_refused",
    "logout",
    "mode",
    "parameter_set",
    "recipe",
    "restore",
    "run",
    "secret",
    "server",
    "shift",
    "swap",
    "token",
    "unit",
    "user",
    "worker",
]
"""A filter for another kind is refused instead of finding nothing. A log of 0.2 has events of ``home``."""

MAX_TIME = 253_370_764_800.0
"""The year 9999, the last one of dates on the screen and in ISO 8601. Unix time in seconds."""
_OPTIONAL = ("about", "bus", "unit", "old", "new", "old_raw", "new_raw", "outcome", "count")
_TEXTS = ("who", "origin", "what", "message")
_BLANK = {**dict.fromkeys(_OPTIONAL), **dict.fromkeys(_TEXTS, "")}
MESSAGE_COLUMNS = ("who", "origin", "what", "old", "new", "message")
"""The fields that may be messages."""


def new_entry(*, kind: str, time: UnixTime, frames: Iterable[Frame] = (), **given: Any) -> dict[str, Any]:
    """Return all fields of an entry except its id. ``time``: Unix time in seconds; ``frames``: those that
    carried the command. A field that is a message holds its English text, and ``messages`` has the
    message."""
    records = [
        FrameRecord(frame.at, frame.direction, frame.data.hex(" ").upper(), frame.meaning, frame.meanings)
        for frame in frames
    ]
    shown = msgspec.json.encode(records).decode()
    entry = {**_BLANK, **given, "kind": kind, "frames": shown}
    messages = {name: _plain(entry[name]) for name in MESSAGE_COLUMNS if isinstance(entry[name], Message)}
    entry |= {name: str(entry[name]) for name in messages}
    entry["messages"] = _compact(messages) if messages else None
    # SQLite has no negative zero.
    return {name: _stored(value) for name, value in entry.items()} | {"time": float(time) + 0.0}


def is_moment(time: UnixTime) -> bool:
    """Return whether a Unix time in seconds can be shown as a date; 0 means an unknown time."""
    return math.isfinite(time) and 0 < float(time) < MAX_TIME


def _plain(message: Any) -> Any:
    """Return a message in the form of JSON."""
    match message:
        case Message(code, params):
            return {"code": code, "params": {name: _plain(value) for name, value in params.items()}}
        case list():
            return [_plain(each) for each in message]
        case _:
            return _stored(message)


def _stored(value: Any) -> Any:
    if isinstance(value, str):
        # Half a surrogate pair, which JSON can escape, is not UTF-8.
        return str(value) if value.isascii() else value.encode("utf-8", "backslashreplace").decode()
    return int(value) if isinstance(value, bool) else value


_compact = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False).encode
_MESSAGES = msgspec.json.Decoder(dict[str, Message])
_KNOWN = {*TEXTS, NUMBER, TERM, LIST}


class FrameRecord(msgspec.Struct):
    """A frame that carried a command. ``at``: Unix time in seconds; ``data``: hexadecimal."""

    at: UnixTime
    direction: str
    data: str
    meaning: str
    meanings: list[Message] = []


def readable(row: Mapping[str, Any]) -> Event:
    """Return a row as an event. If its time or its frames are invalid, ``unreadable`` is true, the time is 0,
    and the frames are left out. ``messages``: those of its fields with a code of this version."""
    has_time, frames = is_moment(row["time"]), frames_of(row["frames"])
    event = {**row, "unreadable": not has_time or frames is None}
    concluded_at = row["concluded_at"]
    if concluded_at is not None and not is_moment(concluded_at):
        event |= {"concluded_at": None, "unreadable": True}
    parts = [messages_of(row["messages"]), messages_of(row["concluded_messages"])]
    messages = {**(parts[0] or {}), **(parts[1] or {})}
    # For a code that this version does not have, the stored text is shown.
    event["messages"] = {name: message for name, message in messages.items() if message.code in _KNOWN}
    if None in parts:
        event["unreadable"] = True
    if not has_time:
        event["time"] = 0.0
    if frames is None:
        event["frames"] = "[]"
    return event


def messages_of(text: str | None) -> dict[str, Message] | None:
    """Return the messages of an entry by field, from its JSON; None if it is invalid."""
    if text is None:
        return {}
    try:
        return _MESSAGES.decode(text)
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None


def frames_of(text: str) -> list[FrameRecord] | None:
    """Return the frames of an entry from its JSON; None if it is invalid."""
    try:
        frames = msgspec.json.decode(text, type=list[FrameRecord])
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None
    return frames if all(is_moment(frame.at) for frame in frames) else None


KEY_BYTES = 32
"""The bytes of a key, as many as a hash has: fewer are discouraged (RFC 2104, 3), more add nothing."""
BEGINNING = "0" * 64
"""The hash before the first entry of a log."""
FIELDS = (
    *("id", "time", "kind", "about", "who", "origin", "bus", "unit"),
    *("what", "old", "new", "old_raw", "new_raw", "outcome", "message", "frames"),
)
"""The fields that the hash of an entry without a key covers, as versions before the key wrote it."""
SEALED_FROM_HERE = Message("event_audit_sealed")
OTHER_KEY = Message("event_audit_other_key")
ROTATED = Message("event_audit_key_rotated")
END_ALTERED = Message("event_audit_end_altered")
"""The remark on an altered end. No failure of the machine causes it: an entry and its seal are written in one
transaction."""
_END_ALTERED_TEXT = "the end of the audit log was altered before this entry"
"""The text of `END_ALTERED` in an entry of a version that kept texts only."""
Purpose = Literal["entry", "head", "anchor", "command", "decoy", "cut"]
"""The purpose of a seal. It is part of the sealed data: no seal passes for one of another purpose."""
canonical = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False, default=str).encode
_DERIVED = frozenset({"hash", "seal"})


@dataclass(frozen=True)
class KeyOrigin:
    """The newest entry of the log when its first key was made; entries up to it have no seal. ``others``:
    chain, number and hash of the ends of further chains, in a log of 0.2."""

    id: int = 0
    hash: str = BEGINNING
    others: tuple[tuple[str, int, str], ...] = ()

    @cached_property
    def hashes(self) -> dict[int, str]:
        """The hash of the end of each chain, by the number of the entry."""
        return {self.id: self.hash, **{number: digest for _, number, digest in self.others}}


@dataclass(frozen=True)
class KeyRing:
    """The keys with which a log was ever sealed, the newest last, which seals new entries."""

    keys: tuple[bytes, ...]
    origin: KeyOrigin = KeyOrigin()

    @cached_property
    def _ranks(self) -> dict[str, int]:
        return {_key_id(key): rank for rank, key in enumerate(self.keys)}

    @cached_property
    def newest(self) -> str:
        """The id of the newest key, 16 hex digits that reveal nothing of the key."""
        return _key_id(self.keys[-1])

    def rank(self, key_id: str) -> int | None:
        """Return the place of a key in order of age; None for an unknown one."""
        return self._ranks.get(key_id)

    def seal(self, purpose: Purpose, *parts: str) -> str:
        """Return the seal of ``parts`` by the newest key, in hexadecimal. Only the last part may contain a
        line feed."""
        return _seal(self.keys[-1], purpose, parts)

    def confirms(self, seal: str, key_id: str, purpose: Purpose, *parts: str) -> bool:
        """Return whether ``seal`` was made of these parts with the key of this id, in constant time."""
        rank = self.rank(key_id)
        return rank is not None and _equal(seal, _seal(self.keys[rank], purpose, parts))

    def confirms_by_any(self, seal: str, purpose: Purpose, *parts: str) -> bool:
        """Return whether ``seal`` was made of these parts with any of the keys, in constant time."""
        return any(_equal(seal, _seal(key, purpose, parts)) for key in self.keys)

    def with_key(self, key: bytes) -> KeyRing:
        """Return a ring with a newer key beside these."""
        return KeyRing((*self.keys, key), self.origin)


def _key_id(key: bytes) -> str:
    return hashlib.sha256(b"lineside audit key\n" + key).hexdigest()[:16]


def _seal(key: bytes, purpose: Purpose, parts: Iterable[str]) -> str:
    message = "\n".join((purpose, *parts))
    return hmac.digest(key, message.encode("utf-8", "surrogatepass"), "sha256").hex()


def _equal(seal: str, right: str) -> bool:
    return hmac.compare_digest(seal.encode("utf-8", "surrogatepass"), right.encode())


@dataclass(frozen=True)
class Head:
    """The newest entry of a chain, and its seal as the newest; ``key`` is empty before the first key.
    ``chain``: the bus of a chain of 0.2; empty for the chain of the site, which continues as the only one."""

    id: int = 0
    hash: str = BEGINNING
    key: str = ""
    seal: str = ""
    chain: str = ""


def newest_of(heads: Iterable[Head]) -> Head:
    """Return the newest of some entries; number 0 if there is none."""
    return max(heads, key=lambda head: head.id, default=Head())


def entry_hash(previous: str, entry: Mapping[str, Any]) -> str:
    """Return the SHA-256, in hex, over the previous hash and the entry as JSON with sorted keys. For an entry
    with a key it covers every column that is not NULL, even those of later versions."""
    covered = {name: value for name, value in entry.items() if value is not None and name not in _DERIVED}
    if not entry.get("key"):
        newer = covered.keys() - {*FIELDS, "previous", "key"}
        covered = {name: entry.get(name) for name in FIELDS} | {name: covered[name] for name in newer}
    return hashlib.sha256(f"{previous}\n{canonical(covered)}".encode("utf-8", "surrogatepass")).hexdigest()


def sealed_entry(previous: str, entry: Mapping[str, Any], ring: KeyRing) -> dict[str, Any]:
    """Chain an entry, which has its id, to the hash before it, and seal it with the newest key."""
    sealed = {**entry, "previous": previous, "key": ring.newest}
    sealed["hash"] = digest = entry_hash(previous, sealed)
    sealed["seal"] = ring.seal("entry", digest)
    return sealed


def is_sound_alone(entry: Mapping[str, Any], ring: KeyRing) -> bool:
    """Return whether an entry is as it was written, whatever was before it; an entry older than the first key
    must only fit its hash."""
    digest = entry_hash(entry.get("previous") or "", entry)
    if entry.get("hash") != digest:
        return False
    seal, key = entry.get("seal") or "", entry.get("key") or ""
    return entry["id"] <= ring.origin.id or ring.confirms(seal, key, "entry", digest)


def sealed_head(entry: Mapping[str, Any], ring: KeyRing, chain: str = "") -> Head:
    """Seal an entry as the newest of a chain."""
    number, digest = entry["id"], entry["hash"]
    return Head(number, digest, ring.newest, ring.seal("head", *_head_parts(number, digest, chain)), chain)


def _head_parts(number: int, digest: str, chain: str) -> tuple[str, ...]:
    return (str(number), digest, chain) if chain else (str(number), digest)


def confirms_head(head: Head, ring: KeyRing) -> bool:
    """Return whether ``head`` was noted with a key of the ring."""
    return ring.confirms(head.seal, head.key, "head", *_head_parts(head.id, head.hash, head.chain))


def remark_on(head: Head, ring: KeyRing) -> Message | None:
    """Return the remark to record about the log itself before anything is added to ``head``; mostly None."""
    if head.id == 0 or confirms_head(head, ring):
        return None
    if not head.key:
        return SEALED_FROM_HERE
    return OTHER_KEY if ring.rank(head.key) is None else END_ALTERED


def notes_altered_end(entry: Mapping[str, Any]) -> bool:
    """Return whether the entry is the remark :data:`END_ALTERED`."""
    if entry["kind"] != "audit":
        return False
    what = (messages_of(entry.get("messages")) or {}).get("what")
    return entry["what"] == _END_ALTERED_TEXT if what is None else what == END_ALTERED


SITE = ""
"""The chain of the site; in mappings by chain, also the only chain that this version writes."""
Ends = Mapping[str, Head]
"""The last entry of each chain, by chain."""
JOINED = Message("event_audit_chains_joined")


def previous_after(ends: Ends) -> str:
    """Return the ``previous`` of the entry that continues all chains: for a single chain the hash of its
    end."""
    if len(ends) > 1:
        plain = {chain: (head.id, head.hash) for chain, head in ends.items()}
        return hashlib.sha256(f"chains\n{canonical(plain)}".encode()).hexdigest()
    return next((head.hash for head in ends.values()), BEGINNING)


def expected_previous(entry: Mapping[str, Any], ends: Ends) -> str:
    """Return the ``previous`` that an entry must have after chains with these ends."""
    chain = entry.get("chain")
    if chain is None:
        return previous_after(ends)
    return (ends.get(chain) or ends.get(SITE, Head())).hash


def advance(ends: dict[str, Head], entry: Mapping[str, Any]) -> None:
    """Move the ends of the chains on by an entry."""
    head, chain = Head(entry["id"], entry["hash"], entry.get("key") or ""), entry.get("chain")
    if chain is None:
        ends.clear()
    if chain is None or chain not in ends:
        ends[SITE] = head
    if chain is not None:
        ends[chain] = head


def chains_named(ends: Ends) -> list[Message]:
    """Return messages about where each chain ended."""
    return [
        Message.of("audit_chain_ended", bus=chain, entry=head.id, hash=head.hash)
        if chain
        else Message.of("audit_chain_of_site_ended", entry=head.id, hash=head.hash)
        for chain, head in sorted(ends.items())
    ]


def origin_of(heads: Ends) -> KeyOrigin:
    """Return the origin of a key that is made now for a log that ends with ``heads``."""
    newest = newest_of(heads.values())
    others: Sequence[tuple[str, int, str]] = [
        (name, head.id, head.hash) for name, head in sorted(heads.items()) if head is not newest
    ]
    return KeyOrigin(newest.id, newest.hash, tuple(others))

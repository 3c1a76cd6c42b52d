"""A transaction as data, and the sealed line that holds it in the local log. Pure.

Each line is sealed with the audit key over the line before and its own text: none can be forged, changed,
left out or put in another place unnoticed. The last line may be cut off: the machine failed before anything
was sent, or its disk has lost the end.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from app.audit.proof.keyring import BEGINNING, KeyRing
from bus.instants import UnixTime
from bus.messages import Message

ALTERED = Message("local_log_altered")
FOREIGN = Message("local_log_of_other_key")


class LoggedEvent(msgspec.Struct, frozen=True):
    """An event that has no number yet: its place in a transaction."""

    ref: str
    place: int = 0


class StoredPart(msgspec.Struct, frozen=True):
    """What a transaction writes beside its events. ``kind`` names who writes it; ``data`` is plain JSON."""

    kind: str
    data: Any = None


class LoggedTransaction(msgspec.Struct, frozen=True):
    """Is written into the database once, however often that is tried: ``ref`` identifies it.

    An entry whose ``about`` is a place in another transaction concludes that event.
    """

    ref: str
    at: UnixTime
    entries: list[dict[str, Any]] = []
    parts: list[StoredPart] = []

    @property
    def events(self) -> list[LoggedEvent]:
        """Each of its events."""
        return [LoggedEvent(self.ref, place) for place in range(len(self.entries))]


def new_transaction(
    at: UnixTime, entries: Sequence[dict[str, Any]] = (), parts: Sequence[StoredPart] = ()
) -> LoggedTransaction:
    """A transaction with a reference that no other has."""
    return LoggedTransaction(secrets.token_hex(16), at, list(entries), list(parts))


@dataclass(frozen=True, slots=True)
class ReadLog:
    """The content of a local log. ``end``: the bytes up to there are good; ``seal``: of the last good line;
    ``fault``: why what follows is not believed; ``is_cut_off``: it ends in the middle of a line."""

    transactions: list[LoggedTransaction] = field(default_factory=list)
    end: int = 0
    seal: str = BEGINNING
    fault: Message | None = None
    is_cut_off: bool = False


def sealed_line(transaction: LoggedTransaction, previous: str, ring: KeyRing) -> tuple[bytes, str]:
    """A transaction as the line after the one with the seal ``previous``, and its own seal."""
    text = msgspec.json.encode(transaction).decode()
    seal = ring.seal("local", previous, text)
    return f"{ring.newest} {seal} {text}\n".encode(), seal


def read_lines(content: bytes, ring: KeyRing) -> ReadLog:
    """The transactions in the bytes of a local log."""
    found: list[LoggedTransaction] = []
    end, previous = 0, BEGINNING
    while (stop := content.find(b"\n", end)) >= 0:
        line = content[end:stop].split(b" ", 2)
        try:
            key_id, seal, text = (part.decode() for part in line)
        except ValueError:
            return ReadLog(found, end, previous, ALTERED)
        if ring.rank(key_id) is None:
            return ReadLog(found, end, previous, FOREIGN)
        if not ring.confirms(seal, key_id, "local", previous, text):
            return ReadLog(found, end, previous, ALTERED)
        try:
            found.append(msgspec.json.decode(text, type=LoggedTransaction))
        except msgspec.MsgspecError:
            return ReadLog(found, end, previous, ALTERED)
        end, previous = stop + 1, seal
    return ReadLog(found, end, previous, is_cut_off=end < len(content))

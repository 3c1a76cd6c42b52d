"""Signed sheets: what the leaving and the coming person have signed, and when."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal
from zoneinfo import ZoneInfo

from app.audit import store
from app.errors import Problem
from app.handover.rules.shift_times import Shift, site_time
from app.web.shape import iso
from bus.instants import UnixTime
from bus.messages import Message, term

SignedPart = Literal["leaving", "coming"]
"""Who signs: the person whose shift ends, then the one whose shift begins."""
EVENTS: dict[SignedPart, str] = {"leaving": "event_shift_signed_over", "coming": "event_shift_taken_over"}

_LOGGED = """
SELECT json_extract(messages, '$.what.code'), who, time, id, json_extract(messages, '$.what.params.start')
FROM events WHERE kind = 'shift' AND about IS NULL
AND CASE WHEN json_valid(messages) THEN json_extract(messages, '$.what.code') IN (?, ?) END
"""


@dataclass(frozen=True, slots=True)
class Signature:
    """``event``: its number in the audit log."""

    part: SignedPart
    who: str
    at: UnixTime
    event: int


@dataclass(frozen=True, slots=True)
class FrozenSheet:
    """A sheet as it was signed: JSON, and its page in the language of the site."""

    shift: Shift
    sheet: bytes
    page: bytes

    @property
    def digest(self) -> str:
        """SHA-256 of the JSON, hexadecimal."""
        return hashlib.sha256(self.sheet).hexdigest()

    @property
    def page_digest(self) -> str:
        return hashlib.sha256(self.page).hexdigest()


@dataclass(frozen=True, slots=True)
class SignedSheet:
    """``is_altered``: it is not what the audit log names."""

    frozen: FrozenSheet
    signatures: Mapping[SignedPart, Signature]
    is_altered: bool


def signed_sheet(connection: sqlite3.Connection, start: UnixTime) -> SignedSheet | None:
    """The signed sheet of the shift that starts then."""
    row = connection.execute("SELECT ends, sheet, page FROM shift_sheet WHERE start = ?", (start,)).fetchone()
    if row is None:
        return None
    frozen = FrozenSheet(Shift(start, UnixTime(row["ends"])), row["sheet"], row["page"])
    signatures = signatures_of(connection, start)
    altered = any(not _is_named(connection, frozen, each) for each in signatures.values())
    return SignedSheet(frozen, signatures, altered or not signatures)


def signatures_of(connection: sqlite3.Connection, start: UnixTime) -> dict[SignedPart, Signature]:
    query = "SELECT part, who, at, event FROM shift_signature WHERE start = ?"
    return {row["part"]: Signature(*row) for row in connection.execute(query, (start,))}


@dataclass(frozen=True, slots=True)
class LoggedSignature(Signature):
    """A signature as the audit log has it. ``start``: of its shift, by the clock of the site."""

    start: str


def missing_signatures(connection: sqlite3.Connection, start: str | None = None) -> list[LoggedSignature]:
    """The signatures that the audit log names and the store has lost, oldest first; ``start``: of one shift.
    Of a store of any version."""
    if not _has(connection, "pragma_table_info('events')", "messages"):
        return []
    stored = _has(connection, "sqlite_master", "shift_signature")
    query = _LOGGED if not stored else f"{_LOGGED} AND id NOT IN (SELECT event FROM shift_signature)"
    parts = {code: part for part, code in EVENTS.items()}
    found = connection.execute(f"{query} ORDER BY id", tuple(parts))
    logged = (LoggedSignature(parts[row[0]], row[1], row[2], row[3], row[4] or "") for row in found)
    return [each for each in logged if start in (None, each.start)]


def _has(connection: sqlite3.Connection, of: str, name: str) -> bool:
    return connection.execute(f"SELECT 1 FROM {of} WHERE name = ?", (name,)).fetchone() is not None


def signed_between(connection: sqlite3.Connection, start: UnixTime, end: UnixTime) -> list[Shift]:
    """The shifts with a signed sheet, newest first. They keep their times when the configuration changes."""
    query = "SELECT start, ends FROM shift_sheet WHERE start >= ? AND start <= ? ORDER BY start DESC"
    return [Shift(*row) for row in connection.execute(query, (start, end))]


def freeze(connection: sqlite3.Connection, frozen: FrozenSheet) -> None:
    """Store a sheet that its first signature follows."""
    row = frozen.shift.start, frozen.shift.end, frozen.sheet, frozen.digest, frozen.page, frozen.page_digest
    connection.execute("INSERT INTO shift_sheet VALUES (?, ?, ?, ?, ?, ?)", row)


def add(connection: sqlite3.Connection, start: UnixTime, part: SignedPart, who: str, at: UnixTime) -> None:
    """Store a signature, in the transaction of its event, which is the newest."""
    (event,) = connection.execute("SELECT max(id) FROM events").fetchone()
    connection.execute("INSERT INTO shift_signature VALUES (?, ?, ?, ?, ?)", (start, part, who, at, event))


def check_turn(
    signatures: Mapping[SignedPart, Signature], part: SignedPart, who: str, zone: ZoneInfo
) -> None:
    """Whether a person may sign this part now. Raises Problem 409."""
    earlier = signatures.get(part)
    if earlier is not None:
        at = site_time(earlier.at, zone)
        message = Message.of("shift_already_signed", part=term(part), who=earlier.who, time=at)
        raise Problem(409, "already_signed", message, who=earlier.who, time=iso(earlier.at))
    if part == "coming" and "leaving" not in signatures:
        raise Problem(409, "not_signed", Message("shift_not_signed_over"))
    if any(each.who == who for each in signatures.values()):
        raise Problem(409, "same_person", Message.of("shift_same_person", who=who))


def _is_named(connection: sqlite3.Connection, frozen: FrozenSheet, signature: Signature) -> bool:
    """Whether the event of a signature names this sheet."""
    event = store.one(connection, signature.event)
    what = None if event is None else event["messages"].get("what")
    digests = {"digest": frozen.digest, "page_digest": frozen.page_digest}
    return (
        event is not None
        and what is not None
        and (what.code, event["who"]) == (EVENTS[signature.part], signature.who)
        and digests.items() <= what.params.items()
    )

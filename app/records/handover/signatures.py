"""The acts of people on a shift, and the stored signatures: the sheet, the user, the time."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal
from zoneinfo import ZoneInfo

from pydantic import Field

from app.core.database import StoreConnection
from app.core.database.connection import has_column, json_member
from app.core.web.access import Role
from app.core.web.shape import InstantObject, iso
from app.errors import Problem
from app.people.audit import log
from app.people.audit.acts import Act
from app.records.handover.rules import Shift, site_time
from bus.instants import UnixTime
from bus.messages import Message, term

SignedPart = Literal["leaving", "coming"]
"""The part of a signer: the person whose shift ends signs first, then the one whose shift begins."""
EVENTS: dict[SignedPart, str] = {"leaving": "event_shift_signed_over", "coming": "event_shift_taken_over"}

_CODE, _START = json_member("messages", "what.code"), json_member("messages", "what.params.start")
_LOGGED = f"""
SELECT {_CODE}, who, time, id, message, {_START}
FROM events WHERE kind = 'shift' AND about IS NULL AND {_CODE} IN (?, ?)
"""


@dataclass(frozen=True, slots=True)
class ShiftSignature:
    """A signature: the user, and the time by the clock of the server."""

    part: SignedPart
    who: str
    at: InstantObject
    event: Annotated[int, Field(description="The number of its entry in the audit log.")]
    reason: Annotated[str, Field(description="Of an early hand-over.")]


@dataclass(frozen=True, slots=True)
class MissingSignature(ShiftSignature):
    """A signature that the audit log names and the store has lost."""

    start: Annotated[str, Field(exclude=True)]
    """The start of its shift, by the clock of the site."""


@dataclass(frozen=True, slots=True)
class SignedSheet:
    """A sheet as signed: JSON, and its page in the language of the site. ``is_altered``: it is not the sheet
    that the audit log names."""

    shift: Shift
    sheet: bytes
    page: bytes
    signatures: Mapping[SignedPart, ShiftSignature] = field(default_factory=dict)
    is_altered: bool = False

    @property
    def digest(self) -> str:
        """SHA-256 of the JSON, hexadecimal."""
        return hashlib.sha256(self.sheet).hexdigest()

    @property
    def page_digest(self) -> str:
        return hashlib.sha256(self.page).hexdigest()


def signed_sheet(connection: StoreConnection, start: UnixTime) -> SignedSheet | None:
    """Return the signed sheet of the shift that starts at this time."""
    row = connection.execute("SELECT ends, sheet, page FROM shift_sheet WHERE start = ?", (start,)).fetchone()
    if row is None:
        return None
    signatures = signatures_of(connection, start)
    signed = SignedSheet(Shift(start, UnixTime(row["ends"])), row["sheet"], row["page"], signatures)
    is_named = all(_is_named(connection, signed, each) for each in signatures.values())
    return signed if signatures and is_named else replace(signed, is_altered=True)


def signatures_of(connection: StoreConnection, start: UnixTime) -> dict[SignedPart, ShiftSignature]:
    query = (
        "SELECT s.part, s.who, s.at, s.event, COALESCE(e.message, '') FROM shift_signature s "
        "LEFT JOIN events e ON e.id = s.event WHERE s.start = ?"
    )
    return {row["part"]: ShiftSignature(*row) for row in connection.execute(query, (start,))}


def missing_signatures(connection: StoreConnection, start: str | None = None) -> list[MissingSignature]:
    """Return the signatures that the audit log names and the store has lost, oldest first; ``start``: of one
    shift only. The store may have any version."""
    if not has_column(connection, "events", "messages"):
        return []
    stored = has_column(connection, "shift_signature", "event")
    query = f"{_LOGGED} AND id NOT IN (SELECT event FROM shift_signature)" if stored else _LOGGED
    parts = {code: part for part, code in EVENTS.items()}
    found = connection.execute(f"{query} ORDER BY id", tuple(parts))
    logged = (
        MissingSignature(parts[code], who, at, event, reason or "", start or "")
        for code, who, at, event, reason, start in found
    )
    return [each for each in logged if start in (None, each.start)]


def signed_between(connection: StoreConnection, start: UnixTime, end: UnixTime) -> list[Shift]:
    """Return the shifts with a signed sheet, newest first. They keep their times if the configuration
    changes."""
    query = "SELECT start, ends FROM shift_sheet WHERE start >= ? AND start <= ? ORDER BY start DESC"
    return [Shift(*row) for row in connection.execute(query, (start, end))]


def freeze(connection: StoreConnection, signed: SignedSheet) -> None:
    """Store a sheet; its first signature follows."""
    row = signed.shift.start, signed.shift.end, signed.sheet, signed.digest, signed.page, signed.page_digest
    connection.execute("INSERT INTO shift_sheet VALUES (?, ?, ?, ?, ?, ?)", row)


def add(connection: StoreConnection, start: UnixTime, part: SignedPart, who: str, at: UnixTime) -> None:
    """Store a signature, in the transaction of its event, which is the newest."""
    (event,) = connection.execute("SELECT max(id) FROM events").fetchone()
    connection.execute("INSERT INTO shift_signature VALUES (?, ?, ?, ?, ?)", (start, part, who, at, event))


def check_turn(
    signatures: Mapping[SignedPart, ShiftSignature], part: SignedPart, who: str, zone: ZoneInfo
) -> None:
    """Check that a person may sign this part now. Raise Problem 409."""
    earlier = signatures.get(part)
    if earlier is not None:
        at = site_time(earlier.at, zone)
        message = Message.of("shift_already_signed", part=term(part), who=earlier.who, time=at)
        raise Problem(409, "already_signed", message, who=earlier.who, time=iso(earlier.at))
    if part == "coming" and "leaving" not in signatures:
        raise Problem(409, "not_signed", Message("shift_not_signed_over"))
    if any(each.who == who for each in signatures.values()):
        raise Problem(409, "same_person", Message.of("shift_same_person", who=who))


def _is_named(connection: StoreConnection, signed: SignedSheet, signature: ShiftSignature) -> bool:
    """Return whether the event of a signature names this sheet."""
    event = log.one(connection, signature.event)
    what = None if event is None else event["messages"].get("what")
    digests = {"digest": signed.digest, "page_digest": signed.page_digest}
    return (
        event is not None
        and what is not None
        and (what.code, event["who"]) == (EVENTS[signature.part], signature.who)
        and digests.items() <= what.params.items()
    )


WRITE_NOTE = Act("write_shift_note", Role.OPERATOR, "shift", "event_shift_note")
CORRECT_NOTE = Act("correct_shift_note", Role.OPERATOR, "shift", "event_shift_note_corrected")
SIGN = Act("sign_shift_sheet", Role.OPERATOR, "shift", EVENTS["leaving"])
TAKE_OVER = Act("take_over_shift", Role.OPERATOR, "shift", EVENTS["coming"])
SIGNATURES: dict[SignedPart, Act] = {"leaving": SIGN, "coming": TAKE_OVER}
ACTS = (WRITE_NOTE, CORRECT_NOTE, *SIGNATURES.values())

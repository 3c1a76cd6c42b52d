"""The service of shifts: the sheet of each, its rendering as one HTML file that needs no server, its signing.

The leaving person signs first, which freezes the sheet; then the coming person signs the same sheet.
"""

from __future__ import annotations

import asyncio
import re
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import islice
from typing import Annotated, Any
from zoneinfo import ZoneInfo

import msgspec
import structlog
from pydantic import Field

from app.core.database import Database, StoreConnection
from app.core.database.connection import snapshot
from app.core.web.access import Person
from app.core.web.assets import Assets
from app.core.web.request_rules import refuse_year
from app.core.web.services import unknown_bus, unknown_unit
from app.core.web.shape import InstantObject, StrictBody, iso
from app.core.web.templating import Templates
from app.errors import Problem, StoreError
from app.line.alarms.journal import JournalEntry
from app.line.alarms.line_alarms import LineAlarms
from app.people.audit.log import EventLog
from app.people.auth.sign_in import SignIn, WrongSecretError
from app.records.handover import notes, signatures
from app.records.handover.figures import LineFigures, SpanFigures, line_summary
from app.records.handover.notes import Note, PictureStore, Quota, RepeatedNoteError, judged
from app.records.handover.rules import PlainPicture, Shift, instant_of, shift_at, shifts_until, site_time
from app.records.handover.sheet import first_event_at, write_sheet
from app.records.handover.signatures import (
    CORRECT_NOTE,
    SIGN,
    SIGNATURES,
    WRITE_NOTE,
    MissingSignature,
    ShiftSignature,
    SignedPart,
    SignedSheet,
    missing_signatures,
    signatures_of,
    signed_between,
    signed_sheet,
)
from app.records.notification.settings import minute_of_day
from app.settings import Settings
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message
from bus.validation import OneLine, TypedText

log = structlog.get_logger()
CLOCK_SKEW_S = 5.0
"""The seconds that the clock of a client may be ahead."""


@dataclass(frozen=True, slots=True)
class NewNote:
    """A note as requested. ``clock``: site time such as 06:30. Now if ``at`` and ``clock`` are both empty."""

    text: str
    at: UnixTime | None = None
    clock: str = ""
    bus: str | None = None
    unit: int | None = None
    alarm: str | None = None
    corrects: int | None = None
    key: str | None = None
    pictures: tuple[bytes, ...] = ()


@dataclass(frozen=True, slots=True)
class ShiftSummary:
    """A shift in the list of shifts."""

    start: InstantObject
    end: InstantObject
    notes: Annotated[int, Field(description="How many it has.")]
    leaving: ShiftSignature | None
    coming: ShiftSignature | None


@dataclass(frozen=True, slots=True)
class SheetOfShift:
    """The sheet of a shift. ``sheet``: its JSON, as signed if it is signed. ``later``: the notes written
    after that. ``missing``: the signatures that the audit log names and the store has lost."""

    shift: Shift
    sheet: bytes
    signed: SignedSheet | None
    later: list[Note]
    missing: list[MissingSignature]


class Handover:
    """The service for a shift's notes, and for the stored data about a shift."""

    def __init__(
        self,
        settings: Settings,
        database: Database,
        events: EventLog,
        pictures: PictureStore,
        figures: SpanFigures,
        clock: Clock = unix_now,
    ) -> None:
        self.figures = figures
        self.quota = Quota(settings.server.data, clock)
        self.zone = ZoneInfo(settings.site.zone)
        self._units = {bus.name: [unit.id for unit in bus.unit] for bus in settings.bus}
        self._starts = settings.shift.minutes
        self._settings = settings
        self._database = database
        self._events = events
        self._pictures = pictures
        self._clock = clock

    async def shift_of(self, start: datetime) -> Shift:
        """Return the shift that starts at this time. Raise Problem 404."""
        at, now = UnixTime(start.timestamp()), self._clock()
        if not UnixTime(0.0) < at <= now:
            raise Problem(404, "unknown_shift", Message("shift_not_begun"))
        signed = await self._database.read(lambda store: signed_between(store, at, at))
        if signed:
            return signed[0]
        shift = shift_at(at, self._starts, self.zone)
        if shift.start != at:
            message = Message.of("shift_unknown", time=self.local(at), start=iso(shift.start))
            raise Problem(404, "unknown_shift", message)
        return shift

    def present(self) -> Shift:
        """Return the shift that is under way."""
        return self.shift_at(self._clock())

    def shift_at(self, at: UnixTime) -> Shift:
        """Return the shift of a moment."""
        return shift_at(at, self._starts, self.zone)

    async def summaries(self, before: datetime | None, limit: int) -> list[ShiftSummary]:
        """Return the shifts that begin before a moment, newest first; None: from the present shift on.

        Raise Problem 422 for a year before any shift.
        """
        latest = self._clock()
        if before is not None:
            refuse_year(before, "before")
            latest = min(latest, UnixTime(before.timestamp() - 1.0))
        shifts = list(islice(shifts_until(latest, self._starts, self.zone), limit))
        return await self._database.read(lambda connection: _summaries(connection, shifts, latest))

    async def begin(self) -> UnixTime | None:
        """Return the time at which the record begins."""
        return await self._database.read(first_event_at)

    async def sheet(self, shift: Shift) -> SheetOfShift:
        """Return the sheet of a shift as signed, else as the store is now, all read at one instant."""
        now, line = self._clock(), await self.line(shift)

        def read(connection: StoreConnection) -> SheetOfShift:
            with snapshot(connection):
                return self._sheet(connection, shift, now, line)

        return await self._database.read_costly(read)

    async def line(self, shift: Shift) -> LineFigures | None:
        """Return the figures of the line in a shift; None if the history cannot be read."""
        try:
            return await self.figures.shift(shift)
        except StoreError as error:
            log.warning(
                "the figures of a shift cannot be read", shift=self.local(shift.start), why=str(error)
            )
            return None

    def _sheet(
        self, connection: StoreConnection, shift: Shift, now: UnixTime, line: LineFigures | None
    ) -> SheetOfShift:
        signed, missing = self._signed(connection, shift)
        if signed is None:
            sheet = write_sheet(connection, self._settings, shift, now)
            if line is not None:
                sheet["line"] = line
            return SheetOfShift(shift, msgspec.json.encode(sheet), None, [], missing)
        known = {note["id"] for note in msgspec.json.decode(signed.sheet)["notes"]}
        later = [note for note in notes.notes_of(connection, shift) if note.id not in known]
        return SheetOfShift(shift, signed.sheet, signed, later, missing)

    async def signed(self, shift: Shift) -> tuple[SignedSheet | None, list[MissingSignature]]:
        """Return a shift's signed sheet, and the signatures of the audit log that the store has lost."""
        return await self._database.read(lambda connection: self._signed(connection, shift))

    def _signed(
        self, connection: StoreConnection, shift: Shift
    ) -> tuple[SignedSheet | None, list[MissingSignature]]:
        missing = missing_signatures(connection, self.local(shift.start))
        return signed_sheet(connection, shift.start), missing

    async def notes_between(self, start: UnixTime, end: UnixTime, units: Sequence[str]) -> list[Note]:
        """Return the newest notes about times in a span, in order: those of the site, and those of each
        ``bus/unit`` and its bus; all if ``units`` is empty."""
        buses = {unit.rpartition("/")[0] for unit in units}

        def concerns(note: Note) -> bool:
            if not units or note.bus is None:
                return True
            return note.bus in buses if note.unit is None else f"{note.bus}/{note.unit}" in units

        found = await self._database.read(lambda store: notes.notes_between(store, start, end))
        return [note for note in found if concerns(note)][-notes.MAX_OF_SPAN :]

    async def write(self, person: Person, shift: Shift, new: NewNote) -> Note:
        """Store a note; one that its sender repeats with the same key is stored once. Raise Problem."""
        act = WRITE_NOTE if new.corrects is None else CORRECT_NOTE
        act.check(person)
        self.check_place(new.bus, new.unit)
        self.quota.check(shift)
        text = new.text.replace("\r\n", "\n").strip()
        if not text:
            raise Problem(422, "invalid", Message("shift_note_empty"))
        pictures = await asyncio.to_thread(judged, new.pictures)
        note = Note(
            at=await self._time_of(shift, new),
            written_at=self._clock(),
            who=person.name,
            text=text,
            bus=new.bus,
            unit=new.unit,
            alarm=new.alarm,
            corrects=new.corrects,
            sender=person.sender,
            key=new.key,
            pictures=" ".join(pictures),
        )
        try:
            await self._database.read(lambda connection: notes.check(connection, note, shift))
            self.quota.count_note(person.sender, 1 + len(pictures))
            await self._pictures.add(pictures)
            return await self._store(person, shift, note)
        except RepeatedNoteError as repeated:
            return repeated.note

    async def _store(self, person: Person, shift: Shift, note: Note) -> Note:
        stored: list[int] = []
        start = self.local(shift.start)
        performed = WRITE_NOTE.by(person, start=start)
        if note.corrects is not None:
            performed = CORRECT_NOTE.by(person, start=start, note=note.corrects)
        await self._events.record(
            **performed,
            bus=note.bus,
            unit=note.unit,
            new=note.pictures or None,
            message=note.text,
            also=lambda connection: stored.append(notes.add(connection, note, shift)),
        )
        return replace(note, id=stored[0])

    async def _time_of(self, shift: Shift, new: NewNote) -> UnixTime:
        """Return the moment that a note is about; for a correction, the moment of the corrected note."""
        now, number = self._clock(), new.corrects
        if number is not None:
            return (await self._database.read(lambda store: notes.find(store, number, shift))).at
        at = new.at
        if new.clock:
            at = instant_of(minute_of_day(new.clock), shift, self.zone)
        elif at is None:
            if not shift.holds(now):
                raise Problem(422, "invalid", Message("shift_note_needs_time"))
            return now
        if at is None or not shift.holds(at) or at > now + CLOCK_SKEW_S:
            raise Problem(422, "invalid", self._outside(shift))
        return min(at, now)

    def _outside(self, shift: Shift) -> Message:
        return Message.of("shift_note_outside", start=self.local(shift.start), end=self.local(shift.end))

    def clock_range(self, shift: Shift) -> tuple[str, float, Message]:
        """Return when a shift starts by the clock, the minutes from there to its end or now, and the refusal
        of a time beyond them. Where the clock was set forward, they are the more that it shows."""
        start, until = (
            datetime.fromtimestamp(float(at), self.zone)
            for at in (shift.start, min(shift.end - 1.0, self._clock()))
        )
        seconds = max(until - start, until.astimezone(UTC) - start.astimezone(UTC)).total_seconds()
        return f"{start:%H:%M}", round(seconds / 60, 2), self._outside(shift)

    def check_place(self, bus: str | None, unit: int | None) -> None:
        """Check that a note can be about a place. Raise Problem 404, or 422 for a unit without a bus."""
        if bus is not None and bus not in self._units:
            raise unknown_bus(bus, self._units)
        if unit is not None and bus is None:
            raise Problem(422, "invalid", Message("shift_note_unit_without_bus"))
        if bus is not None and unit is not None and unit not in self._units[bus]:
            raise unknown_unit(bus, unit)

    async def occurrence(self, alarm_id: str) -> JournalEntry:
        """Return the last transition of an occurrence that a note can be about. Raise Problem 404."""
        return await self._database.read(lambda store: notes.occurrence(store, alarm_id))

    def local(self, at: UnixTime) -> str:
        return site_time(at, self.zone)


def _summaries(connection: StoreConnection, shifts: list[Shift], latest: UnixTime) -> list[ShiftSummary]:
    """Return the computed shifts, and the signed shifts until ``latest`` whose times came from an earlier
    configuration: one may have begun within the newest computed shift."""
    signed = signed_between(connection, shifts[-1].start, latest)
    starts = {shift.start: shift for shift in (*shifts, *signed)}
    listed = sorted(starts.values(), key=lambda shift: -float(shift.start))
    counts = notes.counts_of(connection, listed)
    return [_summary(connection, shift, count) for shift, count in zip(listed, counts, strict=True)]


def _summary(connection: StoreConnection, shift: Shift, count: int) -> ShiftSummary:
    signatures = signatures_of(connection, shift.start)
    leaving, coming = signatures.get("leaving"), signatures.get("coming")
    return ShiftSummary(shift.start, shift.end, count, leaving, coming)


STYLE = "css/pages/handover-document.css"
APART = {
    "Content-Security-Policy": (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; sandbox"
    )
}
"""The headers of files that contain people's texts: such a file is never a page of this site."""
INSTANTS = frozenset(
    {"start", "end", "until", "made_at", "time", "came", "written_at", "again_at", "shelved_until"}
)
_PICTURE = re.compile(r'(?<=<img src=")sha256:([0-9a-f]{64})(?=")')
"""The name of a picture in the page of a sheet. People's texts cannot contain it: they are escaped."""


def readable(part: Any) -> Any:
    """Return a sheet of the API, or a part of one, for templates: with moments instead of instants, and
    messages, which appear in the language of each reader, instead of texts."""
    match part:
        case {"code": _, "params": _}:
            return msgspec.convert(part, Message)
        case dict():
            found = {
                name: _moment(each) if name in INSTANTS else readable(each) for name, each in part.items()
            }
            return found | _texts_of(found) if "trigger" in found else found
        case list():
            return [readable(each) for each in part]
        case _:
            return part


def _moment(text: str | None) -> UnixTime | None:
    return None if text is None else UnixTime(datetime.fromisoformat(text).timestamp())


def _texts_of(transition: Mapping[str, Any]) -> dict[str, str | Message]:
    """Return the name of an alarm (of a built-in one as a message) and its state."""
    alarm, code = transition["alarm"].rpartition(".")[0], transition["code"]
    title = Message(f"alarm_{code}") if alarm.endswith(f".{code}") else transition["name"]
    return {"title": title, "state": Message(f"alarm_state_{transition.get('at_end', transition['after'])}")}


class SheetDocuments:
    """The renderer of sheets, which needs no request."""

    def __init__(
        self, templates: Templates, assets: Assets, alarms: LineAlarms, pictures: PictureStore
    ) -> None:
        self._templates = templates
        self._assets = assets
        self._alarms = alarms
        self._pictures = pictures

    def page(self, sheet: bytes) -> bytes:
        """Return the page of a sheet without its signatures; it is signed together with the data."""
        shown = readable(msgspec.json.decode(sheet))
        return self._rendered(
            "handover/_frozen.html", sheet=shown, line_summary=line_summary, place_of=self._alarms.place
        ).encode()

    async def document(self, found: SheetOfShift) -> str:
        """Return the page with its signatures and pictures as one file."""
        page = (found.signed.page if found.signed else self.page(found.sheet)).decode()
        named = dict.fromkeys(_PICTURE.findall(page))
        pictures = await self._pictures.all_of(named)
        style = self._assets.get(STYLE).body.decode()
        page = _PICTURE.sub(lambda named: _inline(named[1], pictures), page)
        return self._rendered(
            "handover/document.html",
            page=page,
            style=style,
            shift=found.shift,
            signed=found.signed,
            missing=found.missing,
            lost=len(named) - len(pictures),
        )

    def _rendered(self, name: str, **context: object) -> str:
        return self._templates.text(self._templates.site.language, name, **context)


def _inline(digest: str, pictures: Mapping[str, PlainPicture]) -> str:
    """Return an address that contains the picture; a lost picture keeps its name."""
    found = pictures.get(digest)
    if found is None:
        return f"sha256:{digest}"
    return f"data:{found.media_type};base64,{b64encode(found.content).decode()}"


PageWriter = Callable[[bytes], bytes]
"""A function that makes a sheet's page, in the language of the site, from its JSON."""
EARLIEST_S = 1800.0
"""The seconds before the end of a shift at which it can be signed: people meet before its end."""


class ShiftSignRequest(StrictBody):
    """A signature request. Without a name, the session's user signs; a token needs a name and password."""

    part: Annotated[
        SignedPart | None, Field(description="leaving, then coming; null: the one that is missing.")
    ] = None
    digest: Annotated[
        str | None, Field(max_length=64, description="Of the signed sheet that was read; checked.")
    ] = None
    name: Annotated[TypedText, Field(max_length=64)] = ""
    password: Annotated[str, Field(max_length=1000)] = ""
    reason: Annotated[
        OneLine,
        Field(max_length=200, description="Why it is signed earlier than half an hour before its end."),
    ] = ""


class Signing:
    """The service that signs the shifts of a site."""

    def __init__(
        self,
        handover: Handover,
        database: Database,
        events: EventLog,
        sign_in: SignIn,
        page_of: PageWriter,
        clock: Clock = unix_now,
    ) -> None:
        self._handover = handover
        self._database = database
        self._events = events
        self._sign_in = sign_in
        self._page_of = page_of
        self._clock = clock

    async def sign(self, person: Person, address: str, shift: Shift, request: ShiftSignRequest) -> None:
        """Sign the sheet of a shift. Raise Problem 409 if it is signed already or the other part is due, 401
        for a wrong password, 403 for a user who may not sign, and the errors of `Quota.check`."""
        SIGN.check(person)
        self._handover.quota.check(shift)
        signer = await self._signer(person, address, request)
        signed, missing = await self._handover.signed(shift)
        if missing:
            names = ", ".join(each.who for each in missing)
            raise Problem(409, "not_in_state", Message.of("shift_signature_missing", names=names))
        part = request.part or ("leaving" if signed is None else "coming")
        there = {} if signed is None else signed.signatures
        signatures.check_turn(there, part, signer.name, self._handover.zone)
        if signed is None:
            signed = await self._freeze(shift, request.reason.strip())
        elif request.digest not in (None, signed.digest):
            raise Problem(409, "superseded", Message("shift_sheet_differs"), digest=signed.digest)
        elif signed.is_altered:
            raise Problem(409, "not_in_state", Message("shift_sheet_altered"))
        await self._store(signer, part, signed, request.reason.strip())

    def early_until(self, shift: Shift) -> UnixTime | None:
        """Return the time before which a handover needs a reason; None if the shift's end is near."""
        earliest = shift.end - EARLIEST_S
        return earliest if self._clock() < earliest else None

    async def _freeze(self, shift: Shift, reason: str) -> SignedSheet:
        earliest = self.early_until(shift)
        if earliest is not None and not reason:
            times = {"end": self._handover.local(shift.end), "earliest": self._handover.local(earliest)}
            raise Problem(409, "not_in_state", Message.of("shift_sign_too_early", **times))
        sheet = (await self._handover.sheet(shift)).sheet
        return SignedSheet(shift, sheet, self._page_of(sheet))

    async def _store(self, signer: Person, part: SignedPart, signed: SignedSheet, reason: str) -> None:
        start, now = signed.shift.start, self._clock()

        def store(connection: StoreConnection) -> None:
            there = signatures.signatures_of(connection, start)
            signatures.check_turn(there, part, signer.name, self._handover.zone)
            if not signed.signatures:
                signatures.freeze(connection, signed)
            signatures.add(connection, start, part, signer.name, now)

        await self._events.record(
            **SIGNATURES[part].by(
                signer,
                start=self._handover.local(start),
                digest=signed.digest,
                page_digest=signed.page_digest,
            ),
            at=now,
            message=reason,
            also=store,
        )

    async def _signer(self, person: Person, address: str, request: ShiftSignRequest) -> Person:
        """Return the user of the name and password if they are given, else the user of the session."""
        if not request.name and not request.password:
            if person.via != "session" or person.panel:
                raise Problem(403, "forbidden", Message("shift_sign_needs_person"))
            return person
        name = request.name.strip()
        if await self._sign_in.has_company_account(name):
            raise Problem(403, "forbidden", Message.of("shift_sign_in_own_session", name=name))
        try:
            user = await self._sign_in.identify(name, request.password, address)
        except WrongSecretError:
            await self._sign_in.note_refusal(name, address)
            raise
        signer = Person(user.name, user.role, person.via)
        SIGN.check(signer)
        return signer

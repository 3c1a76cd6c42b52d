"""The shifts of a site: their notes and sheets."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import islice
from typing import Annotated
from zoneinfo import ZoneInfo

import msgspec
from pydantic import Field

from app.core.database import Database, StoreConnection
from app.core.database.connection import snapshot
from app.core.web.access import Person
from app.core.web.request_rules import refuse_year
from app.core.web.services import unknown_bus, unknown_unit
from app.core.web.shape import InstantObject, iso
from app.errors import Problem
from app.line.alarms.journal import JournalEntry
from app.people.audit.log import EventLog
from app.records.handover import notes
from app.records.handover.notes import Note, Quota, RepeatedNoteError
from app.records.handover.pictures import PictureStore, judged
from app.records.handover.rules.shifts import Shift, instant_of, shift_at, shifts_until, site_time
from app.records.handover.sheet import write_sheet
from app.records.handover.signatures import (
    CORRECT_NOTE,
    WRITE_NOTE,
    MissingSignature,
    ShiftSignature,
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

CLOCK_SKEW_S = 5.0
"""By which the clock of a client may be ahead."""


@dataclass(frozen=True, slots=True)
class NewNote:
    """A note as it was requested. ``at`` and ``clock`` (06:30, at the site) both empty: now."""

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
    """A shift in the list."""

    start: InstantObject
    end: InstantObject
    notes: Annotated[int, Field(description="How many it has.")]
    leaving: ShiftSignature | None
    coming: ShiftSignature | None


@dataclass(frozen=True, slots=True)
class SheetOfShift:
    """``sheet``: its JSON, as it was signed where it is. ``later``: the notes that were written since.
    ``missing``: the signatures that the audit log names and the store has lost."""

    shift: Shift
    sheet: bytes
    signed: SignedSheet | None
    later: list[Note]
    missing: list[MissingSignature]


class Handover:
    """What people write about a shift, and what the store holds of it."""

    def __init__(
        self,
        settings: Settings,
        database: Database,
        events: EventLog,
        pictures: PictureStore,
        clock: Clock = unix_now,
    ) -> None:
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
        """Return the shift that starts then. Raises Problem 404."""
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
        """Return the shift that a moment is in."""
        return shift_at(at, self._starts, self.zone)

    async def summaries(self, before: datetime | None, limit: int) -> list[ShiftSummary]:
        """Return the shifts that begin before a moment, newest first; None: from the present one on.

        Raises Problem 422 for a year before any shift.
        """
        latest = self._clock()
        if before is not None:
            refuse_year(before, "before")
            latest = min(latest, UnixTime(before.timestamp() - 1.0))
        shifts = list(islice(shifts_until(latest, self._starts, self.zone), limit))
        return await self._database.read(lambda connection: _summaries(connection, shifts, latest))

    async def sheet(self, shift: Shift) -> SheetOfShift:
        """Return the sheet of a shift, as it was signed or as it would be now; read at one instant."""
        now = self._clock()

        def read(connection: StoreConnection) -> SheetOfShift:
            with snapshot(connection):
                return self._sheet(connection, shift, now)

        return await self._database.read_costly(read)

    def _sheet(self, connection: StoreConnection, shift: Shift, now: UnixTime) -> SheetOfShift:
        signed, missing = self._signed(connection, shift)
        if signed is None:
            sheet = write_sheet(connection, self._settings, shift, now)
            return SheetOfShift(shift, msgspec.json.encode(sheet), None, [], missing)
        known = {note["id"] for note in msgspec.json.decode(signed.sheet)["notes"]}
        later = [note for note in notes.notes_of(connection, shift) if note.id not in known]
        return SheetOfShift(shift, signed.sheet, signed, later, missing)

    async def signed(self, shift: Shift) -> tuple[SignedSheet | None, list[MissingSignature]]:
        """Return the signed sheet of a shift, and the signatures of the audit log that the store has lost."""
        return await self._database.read(lambda connection: self._signed(connection, shift))

    def _signed(
        self, connection: StoreConnection, shift: Shift
    ) -> tuple[SignedSheet | None, list[MissingSignature]]:
        missing = missing_signatures(connection, self.local(shift.start))
        return signed_sheet(connection, shift.start), missing

    async def notes_between(self, start: UnixTime, end: UnixTime, units: Sequence[str]) -> list[Note]:
        """Return the newest notes about a time of a span, in order: of the site, and of each ``bus/unit`` and
        its bus; without any, all."""
        buses = {unit.rpartition("/")[0] for unit in units}

        def concerns(note: Note) -> bool:
            if not units or note.bus is None:
                return True
            return note.bus in buses if note.unit is None else f"{note.bus}/{note.unit}" in units

        found = await self._database.read(lambda store: notes.notes_between(store, start, end))
        return [note for note in found if concerns(note)][-notes.MAX_OF_SPAN :]

    async def write(self, person: Person, shift: Shift, new: NewNote) -> Note:
        """Store a note; one that its sender sends again with its key is stored once. Raises Problem."""
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
            self.quota.take(person.sender, 1 + len(pictures))
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
        """Return the moment that a note is about. A correction is about that of the note that it corrects."""
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
            start, end = self.local(shift.start), self.local(shift.end)
            raise Problem(422, "invalid", Message.of("shift_note_outside", start=start, end=end))
        return min(at, now)

    def check_place(self, bus: str | None, unit: int | None) -> None:
        """Check that a note can be about a place. Raises Problem 404, and 422 for a unit without its bus."""
        if bus is not None and bus not in self._units:
            raise unknown_bus(bus, self._units)
        if unit is not None and bus is None:
            raise Problem(422, "invalid", Message("shift_note_unit_without_bus"))
        if bus is not None and unit is not None and unit not in self._units[bus]:
            raise unknown_unit(bus, unit)

    async def occurrence(self, alarm_id: str) -> JournalEntry:
        """Return the last transition of an occurrence that a note can be about. Raises Problem 404."""
        return await self._database.read(lambda store: notes.occurrence(store, alarm_id))

    def local(self, at: UnixTime) -> str:
        return site_time(at, self.zone)


def _summaries(connection: StoreConnection, shifts: list[Shift], latest: UnixTime) -> list[ShiftSummary]:
    """Return the computed shifts, and the signed ones until ``latest`` that had other times by their
    configuration: one may have begun within the newest of the computed."""
    signed = signed_between(connection, shifts[-1].start, latest)
    starts = {shift.start: shift for shift in (*shifts, *signed)}
    listed = sorted(starts.values(), key=lambda shift: -float(shift.start))
    counts = notes.counts_of(connection, listed)
    return [_summary(connection, shift, count) for shift, count in zip(listed, counts, strict=True)]


def _summary(connection: StoreConnection, shift: Shift, count: int) -> ShiftSummary:
    signatures = signatures_of(connection, shift.start)
    leaving, coming = signatures.get("leaving"), signatures.get("coming")
    return ShiftSummary(shift.start, shift.end, count, leaving, coming)

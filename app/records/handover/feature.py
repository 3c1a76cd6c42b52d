"""The feature of shift handover: the list of shifts, and a sheet with notes, pictures and signatures."""

from __future__ import annotations

import asyncio
import secrets
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Annotated, Any
from urllib.parse import urlencode

import msgspec
from fastapi import APIRouter, Depends, File, Form, Path, Query, UploadFile
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.database import Database
from app.core.messages.languages import day_begins
from app.core.web.access import Person, Viewer, address_of
from app.core.web.assets import Assets
from app.core.web.request_rules import MAX_BODY_BYTES
from app.core.web.routes import SEARCH, GuardedRoute
from app.core.web.services import service
from app.core.web.shape import ZonedTime
from app.core.web.templating import Templates, formats_of, render
from app.errors import Problem
from app.feature import Feature, Services
from app.line.alarms.api import Alarms, transition_json
from app.line.alarms.line_alarms import LineAlarms
from app.line.history.service import History
from app.people.audit.log import EventLog
from app.people.auth.sign_in import SignIn
from app.records.handover import api
from app.records.handover.api import MAX_NOTE_LENGTH, ShiftOfPath, Shifts, Sign
from app.records.handover.figures import SpanFigures, line_summary
from app.records.handover.notes import MAX_OF_NOTE, PictureStore
from app.records.handover.rules import Shift
from app.records.handover.service import (
    APART,
    Handover,
    NewNote,
    SheetDocuments,
    ShiftSignRequest,
    Signing,
    readable,
)
from app.records.handover.sheet import notes_json
from app.records.handover.signatures import ACTS, SIGN, WRITE_NOTE, SignedPart
from bus.instants import UnixTime, unix_now
from bus.validation import Lines, OneLine, TypedText

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

ON_A_PAGE = 30
SEE_OTHER = 303
Pictures = Annotated[PictureStore, service(PictureStore)]
FORM_LIMITS: Any = {"max_files": MAX_OF_NOTE, "max_fields": 20}
FormNoteText = Annotated[Lines, Form(max_length=MAX_NOTE_LENGTH)]
PinnedPlace = Annotated[OneLine, Query(max_length=100)]
PinnedAlarm = Annotated[OneLine, Query(max_length=300)]
FormReason = Annotated[OneLine, Form(max_length=200)]
FormWord = Annotated[OneLine, Form(max_length=300)]


@router.get("/shifts")
async def shifts_page(
    request: Request,
    _: Viewer,
    shifts: Shifts,
    before: ZonedTime | None = None,
    day: Annotated[TypedText, Query(max_length=20)] = "",
) -> Response:
    """Show the present shift and those before it, or the shifts of the site's ``day`` and those before."""
    formats = formats_of(request)
    next_day = day_begins(formats.typed_time(day), shifts.zone.key, timedelta(days=1))
    fault = formats.malformed_day(day, unix_now()) if day and next_day is None else None
    if next_day is not None and before is None:
        before = datetime.fromtimestamp(float(next_day), UTC)
    found = await shifts.summaries(before, ON_A_PAGE)
    return render(
        request,
        "handover/page.html",
        status=422 if fault else 200,
        fault=fault,
        day=day,
        line_summary=line_summary,
        rows=[(each, _path(each.start), shifts.figures.known(Shift(each.start, each.end))) for each in found],
        unreadable={shift.start for shift in shifts.figures.unreadable},
        address=request.url.path + (f"?{request.url.query}" if request.url.query else ""),
        present=shifts.present(),
        older=_stamp(found[-1].start),
        begins=await shifts.begin() or unix_now(),
        before=before,
    )


@router.get("/shifts/present")
async def present_page(
    _: Viewer, shifts: Shifts, place: PinnedPlace = "", alarm: PinnedAlarm = ""
) -> Response:
    """Redirect to the sheet of the shift that is under way at that time or, with the subject of a note, to
    the form of a note."""
    pinned = urlencode({name: value for name, value in (("place", place), ("alarm", alarm)) if value})
    path = _path(shifts.present().start)
    return RedirectResponse(f"{path}/note?{pinned}" if pinned else path, SEE_OTHER)


@router.get("/shifts/pictures/{digest}")
async def picture(
    _: Viewer, pictures: Pictures, digest: Annotated[str, Path(pattern="^[0-9a-f]{64}$")]
) -> Response:
    """Send a picture of a note by its SHA-256. It never changes, and browsers never show it as a page."""
    found = await pictures.find(digest)
    headers = {**APART, "Cache-Control": "private, max-age=31536000, immutable"}
    return Response(found.content, media_type=found.media_type, headers=headers)


@router.get("/shifts/{start}", dependencies=[SEARCH])
async def sheet_page(
    request: Request, person: Viewer, shifts: Shifts, signing: Sign, alarms: Alarms, shift: ShiftOfPath
) -> Response:
    """Show the sheet of a shift, its signatures, and the form for signing it."""
    return await _sheet(request, person, shifts, signing, alarms, shift)


async def _sheet(
    request: Request,
    person: Person,
    shifts: Handover,
    signing: Signing,
    alarms: LineAlarms,
    shift: Shift,
    *,
    status: int = 200,
    **refused: Any,
) -> Response:
    """Return the page of a sheet; ``refused``: the name and the error of a signature that was refused."""
    found = await shifts.sheet(shift)
    return render(
        request,
        "handover/sheet.html",
        status=status,
        refused={"name": "", "reason": "", "error": None, **refused},
        sheet=readable(msgspec.json.decode(found.sheet)),
        line_summary=line_summary,
        later=readable(notes_json(found.later)),
        signed=found.signed,
        missing=found.missing,
        signs_as=person.name if person.via == "session" and not person.panel else "",
        signs_from=None if found.signed else signing.early_until(shift),
        shift=shift,
        page=_path(shift.start),
        place_of=alarms.place,
        is_present=shift == shifts.present(),
        is_recent=shifts.quota.is_recent(shift),
    )


@router.get("/shifts/{start}/note", dependencies=[SEARCH])
async def note_page(
    request: Request,
    _: Annotated[Person, WRITE_NOTE.permitted],
    shifts: Shifts,
    alarms: Alarms,
    shift: ShiftOfPath,
    correct: Annotated[int | None, Query(ge=1, le=2**62)] = None,
    place: PinnedPlace = "",
    alarm: PinnedAlarm = "",
) -> Response:
    """Show the form for a note. ``correct``: the note that it corrects; ``place`` and ``alarm``: the subject
    of a new note, unless the person chooses another."""
    shifts.check_place(*_place(place))
    pinned_alarm = await shifts.occurrence(alarm) if alarm else None
    found = await shifts.sheet(shift)
    sheet, later = readable(msgspec.json.decode(found.sheet)), readable(notes_json(found.later))
    return render(
        request,
        "handover/note.html",
        sheet=sheet,
        shift=shift,
        page=_path(shift.start),
        corrected=next((note for note in (*sheet["notes"], *later) if note["id"] == correct), None),
        pinned_place=place,
        pinned_alarm=pinned_alarm and readable(transition_json(pinned_alarm)),
        places=alarms.places(),
        place_of=alarms.place,
        is_present=shift == shifts.present(),
        clock_range=shifts.clock_range(shift),
        key=secrets.token_urlsafe(16),
        longest=MAX_NOTE_LENGTH,
    )


async def _new_note(
    text: FormNoteText = "",
    clock: Annotated[str, Form(pattern=r"^(?:(?:[01]?\d|2[0-3]):[0-5]\d)?$")] = "",
    place: FormWord = "",
    alarm: FormWord = "",
    corrects: Annotated[int | None, Form(ge=1, le=2**62)] = None,
    key: Annotated[str | None, Form(min_length=1, max_length=200)] = None,
    pictures: Annotated[list[UploadFile] | None, File()] = None,
) -> NewNote:
    bus, unit = _place(place)
    return NewNote(
        text=text,
        clock=clock,
        bus=bus,
        unit=unit,
        alarm=alarm or None,
        corrects=corrects,
        key=key,
        pictures=tuple([await each.read() for each in pictures or () if each.filename]),
    )


@router.post("/shifts/{start}/notes", max_body_size=MAX_BODY_BYTES, form_limits=FORM_LIMITS)
async def write_note(
    person: Annotated[Person, WRITE_NOTE.permitted],
    shifts: Shifts,
    shift: ShiftOfPath,
    new: Annotated[NewNote, Depends(_new_note)],
) -> Response:
    """Write a note in a shift."""
    note = await shifts.write(person, shift, new)
    return RedirectResponse(f"{_path(shift.start)}#note-{note.id}", SEE_OTHER)


@router.post("/shifts/{start}/sign")
async def sign(
    request: Request,
    person: Annotated[Person, SIGN.permitted],
    shifts: Shifts,
    signing: Sign,
    alarms: Alarms,
    shift: ShiftOfPath,
    part: Annotated[SignedPart, Form()],
    digest: Annotated[str | None, Form(max_length=64)] = None,
    name: Annotated[str, Form(max_length=64)] = "",
    password: Annotated[str, Form(max_length=1000)] = "",
    reason: FormReason = "",
) -> Response:
    """Sign a sheet as the user of the session, or by name and password; a wrong one is named at its field."""
    wanted = ShiftSignRequest(part=part, digest=digest, name=name, password=password, reason=reason)
    try:
        await signing.sign(person, address_of(request), shift, wanted)
    except Problem as problem:
        if problem.status != 401:
            raise
        error = {"name": name, "reason": reason, "error": problem.message}
        return await _sheet(request, person, shifts, signing, alarms, shift, status=401, **error)
    return RedirectResponse(f"{_path(shift.start)}#signatures", SEE_OTHER)


def _place(written: str) -> tuple[str | None, int | None]:
    """Parse a bus, or a unit such as ``dry-end/4``."""
    bus, _, unit = written.partition("/")
    address = int(unit) if unit.isascii() and unit.isdecimal() and len(unit) < 4 else None
    return bus or None, address


def _path(start: UnixTime) -> str:
    return f"/shifts/{_stamp(start)}"


def _stamp(at: UnixTime) -> str:
    return datetime.fromtimestamp(float(at), UTC).isoformat().replace("+00:00", "Z")


def make(services: Services) -> None:
    settings, database, events = services.settings, services[Database], services[EventLog]
    pictures = services.add(PictureStore(settings.server.data, settings.shift.pictures_mb))
    services.lifespan.add("pictures", end=partial(asyncio.to_thread, pictures.close))
    figures = services.add(SpanFigures(settings, database, services[History]))
    services.lifespan.add("figures of shifts", figures.follow)
    handover = services.add(Handover(settings, database, events, pictures, figures))
    templates, assets = services[Templates], services[Assets]
    documents = services.add(SheetDocuments(templates, assets, services[LineAlarms], pictures))
    services.add(Signing(handover, database, events, services[SignIn], documents.page))


FEATURE = Feature(make, (api.router, router), ACTS)

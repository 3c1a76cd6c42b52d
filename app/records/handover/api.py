"""The HTTP API of shifts: the list, the sheet of one shift, its notes."""

from __future__ import annotations

from base64 import b64decode
from typing import Annotated, Any

import msgspec
from fastapi import APIRouter, Depends, Path, Query
from pydantic import Field, TypeAdapter
from starlette.requests import Request
from starlette.responses import Response
from typing_extensions import TypedDict

from app.core.web.access import Person, Viewer, address_of
from app.core.web.api import ApiRoute, RequestKey, limited, problems
from app.core.web.request_rules import MAX_BODY_BYTES
from app.core.web.routes import SEARCH
from app.core.web.services import service
from app.core.web.shape import Instant, StrictBody, ZonedTime, attachment, iso
from app.errors import Problem
from app.line.history.api import SpanOf
from app.line.history.service import seconds
from app.records.handover.notes import MAX_OF_NOTE
from app.records.handover.rules import Shift
from app.records.handover.service import (
    APART,
    Handover,
    NewNote,
    SheetDocuments,
    ShiftSignRequest,
    ShiftSummary,
    Signing,
)
from app.records.handover.sheet import (
    ShiftNote,
    ShiftSheet,
    ShiftSignatures,
    SignaturesOfSheet,
    SignedShiftSheet,
    notes_json,
    signed_json,
)
from app.records.handover.signatures import SIGN, WRITE_NOTE
from bus.instants import UnixTime
from bus.messages import Message
from bus.validation import Lines, OneLine

router = APIRouter(prefix="/api/v1/shifts", tags=["shifts"], route_class=ApiRoute)

MAX_NOTE_LENGTH = 2000
MAX_SHIFTS = 100
MAX_UNITS = 255
Shifts = Annotated[Handover, service(Handover)]
Sign = Annotated[Signing, service(Signing)]
Documents = Annotated[SheetDocuments, service(SheetDocuments)]
SIGNED_JSON: dict[int | str, dict[str, Any]] = {
    200: {"model": SignedShiftSheet},
    **problems(409),
}
HTML: dict[int | str, dict[str, Any]] = {200: {"content": {"text/html": {"schema": {"type": "string"}}}}}
_SIGNATURES = TypeAdapter(SignaturesOfSheet)
NoteText = Annotated[Lines, Field(min_length=1, max_length=MAX_NOTE_LENGTH)]


async def _shift_of(
    shifts: Shifts,
    start: Annotated[ZonedTime, Path(description="When it starts. ISO 8601 with zone.")],
) -> Shift:
    return await shifts.shift_of(start)


ShiftOfPath = Annotated[Shift, Depends(_shift_of)]


class ShiftNoteRequest(StrictBody):
    """A new note. Without ``time`` it is about the present."""

    text: NoteText
    time: Annotated[
        ZonedTime | None, Field(strict=False, description="In the shift, not in the future; with zone.")
    ] = None
    bus: Annotated[OneLine, Field(max_length=80)] | None = None
    unit: Annotated[int | None, Field(ge=1, le=255)] = None
    alarm: Annotated[OneLine, Field(max_length=300, description="The id of an occurrence.")] | None = None
    corrects: Annotated[
        int | None, Field(ge=1, le=2**62, description="The note to correct; it stays as it is.")
    ] = None
    pictures: Annotated[
        tuple[str, ...],
        Field(strict=False, max_length=MAX_OF_NOTE, description="JPEG, PNG or WebP, each in base64."),
    ] = ()


class ShiftsShown(TypedDict):
    """Shifts, newest first. ``next`` is the ``before`` of the next page."""

    shifts: list[ShiftSummary]
    next: Instant


@router.get("")
async def get_shifts(
    _: Viewer,
    shifts: Shifts,
    before: ZonedTime | None = None,
    limit: Annotated[int, Query(ge=1, le=MAX_SHIFTS)] = 30,
) -> ShiftsShown:
    """List the present shift and the shifts before it."""
    found = await shifts.summaries(before, limit)
    return {"shifts": found, "next": iso(found[-1].start)}


class NoteRequest(StrictBody):
    """A new note about a time, whichever shift that time is in."""

    text: NoteText
    time: Annotated[ZonedTime, Field(strict=False, description="Not in the future; with zone.")]
    bus: Annotated[OneLine, Field(max_length=80)] | None = None
    unit: Annotated[int | None, Field(ge=1, le=255)] = None


class NotesOfSpan(TypedDict):
    """The notes of a span, in the order of their times, corrected notes only in their last form."""

    notes: list[ShiftNote]


@router.get("/notes", dependencies=[SEARCH])
async def get_notes_of_span(
    _: Viewer,
    shifts: Shifts,
    span: SpanOf,
    unit: Annotated[list[str] | None, Query(max_length=MAX_UNITS)] = None,
) -> NotesOfSpan:
    """List the notes about times in the span: those of the site, and those of each ``bus/unit`` named and its
    bus (all if none is named). At most the newest 200."""
    found = await shifts.notes_between(seconds(span.start), seconds(span.end), unit or [])
    return {"notes": notes_json(found)}


@router.post("/notes", status_code=201, responses=limited(201))
async def write_note(
    person: Annotated[Person, WRITE_NOTE.permitted],
    shifts: Shifts,
    body: NoteRequest,
    response: Response,
    key: RequestKey = None,
) -> ShiftNote:
    """Write a note about a time. It belongs to the shift of that time and is on the sheet of that shift."""
    at = UnixTime(body.time.timestamp())
    new = NewNote(text=body.text, at=at, bus=body.bus, unit=body.unit, key=key)
    written = await shifts.write(person, shifts.shift_at(at), new)
    response.headers.update(shifts.quota.rate_limit(person.sender).headers)
    return notes_json([written])[0]


@router.get("/{start}", response_model=ShiftSheet, dependencies=[SEARCH])
async def get_shift_sheet(_: Viewer, shifts: Shifts, shift: ShiftOfPath) -> Response:
    """Return the sheet of a shift: as signed, else made from the store, for the present shift up to now."""
    found = await shifts.sheet(shift)
    more: SignaturesOfSheet = {
        "signed": signed_json(found.signed),
        "missing_signatures": found.missing,
        "later_notes": notes_json(found.later),
    }
    sheet = msgspec.json.decode(found.sheet) | _SIGNATURES.dump_python(more)
    return Response(msgspec.json.encode(sheet), media_type="application/json")


@router.get("/{start}/sheet.json", response_class=Response, responses=SIGNED_JSON, dependencies=[SEARCH])
async def get_signed_shift_sheet(_: Viewer, shifts: Shifts, shift: ShiftOfPath) -> Response:
    """Return the bytes of the signed sheet, of which ``digest`` is the SHA-256."""
    signed = (await shifts.sheet(shift)).signed
    if signed is None:
        raise Problem(409, "not_signed", Message("shift_not_signed_over"))
    return Response(signed.sheet, media_type="application/json")


@router.get("/{start}/sheet.html", response_class=Response, responses=HTML, dependencies=[SEARCH])
async def get_shift_document(_: Viewer, shifts: Shifts, documents: Documents, shift: ShiftOfPath) -> Response:
    """Return the sheet, signed or not, with its signatures as one HTML file in the language of the site."""
    found = await shifts.sheet(shift)
    name = f"shift-{iso(found.shift.start)[:16].replace(':', '')}Z.html"
    headers = {**APART, **attachment(name)}
    return Response(await documents.document(found), media_type="text/html; charset=utf-8", headers=headers)


@router.post("/{start}/sign")
async def sign_shift_sheet(
    request: Request,
    person: Annotated[Person, SIGN.permitted],
    shifts: Shifts,
    signing: Sign,
    shift: ShiftOfPath,
    body: ShiftSignRequest | None = None,
) -> ShiftSignatures:
    """Sign the sheet: first the leaving person, which freezes it, then the coming person, another user."""
    await signing.sign(person, address_of(request), shift, body or ShiftSignRequest())
    signed = signed_json((await shifts.sheet(shift)).signed)
    assert signed is not None
    return signed


@router.post("/{start}/notes", status_code=201, max_body_size=MAX_BODY_BYTES, responses=limited(201))
async def write_shift_note(
    person: Annotated[Person, WRITE_NOTE.permitted],
    shifts: Shifts,
    shift: ShiftOfPath,
    body: ShiftNoteRequest,
    response: Response,
    key: RequestKey = None,
) -> ShiftNote:
    """Write a note. It never changes; a correction is a new note that names the corrected one."""
    new = NewNote(
        **body.model_dump(exclude={"time", "pictures"}),
        at=UnixTime(body.time.timestamp()) if body.time else None,
        key=key,
        pictures=tuple(_decoded(each) for each in body.pictures),
    )
    written = await shifts.write(person, shift, new)
    response.headers.update(shifts.quota.rate_limit(person.sender).headers)
    return notes_json([written])[0]


def _decoded(text: str) -> bytes:
    try:
        return b64decode(text, validate=True)
    except ValueError:
        raise Problem(422, "invalid", Message("picture_not_base64")) from None

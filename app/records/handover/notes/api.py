"""Notes by what they are about, across shifts: what a chart shows, and what is written on it."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import Field
from starlette.responses import Response
from typing_extensions import TypedDict

from app.core.web.admission.access import Person, Viewer
from app.core.web.admission.turns import SEARCH
from app.core.web.api.route import ApiRoute, RequestKey
from app.core.web.api.schema import limited
from app.core.web.api.shape import StrictBody, ZonedTime
from app.line.history.service import seconds
from app.line.history.spans import SpanOf
from app.records.handover.acts import WRITE_NOTE
from app.records.handover.api import NoteText, Shifts
from app.records.handover.service import NewNote
from app.records.handover.sheet.sheet import ShiftNote, notes_json
from bus.instants import UnixTime
from bus.text import OneLine

router = APIRouter(prefix="/api/v1/shifts", tags=["shifts"], route_class=ApiRoute)
MAX_UNITS = 255


class NoteRequest(StrictBody):
    """A note about a time, in whichever shift that is."""

    text: NoteText
    time: Annotated[ZonedTime, Field(strict=False, description="Not in the future; with zone.")]
    bus: Annotated[OneLine, Field(max_length=80)] | None = None
    unit: Annotated[int | None, Field(ge=1, le=255)] = None


class NotesOfSpan(TypedDict):
    """Notes of a span, in the order of what they are about; corrected ones as they were corrected."""

    notes: list[ShiftNote]


@router.get("/notes", dependencies=[SEARCH])
async def get_notes_of_span(
    _: Viewer,
    shifts: Shifts,
    span: SpanOf,
    unit: Annotated[list[str] | None, Query(max_length=MAX_UNITS)] = None,
) -> NotesOfSpan:
    """The notes about a time of the span: of the site, and of each ``bus/unit`` named with its bus, or all.
    At most the newest 200."""
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
    """Write a note about a time: it is one of the shift of that time, as on its hand-over sheet."""
    at = UnixTime(body.time.timestamp())
    new = NewNote(text=body.text, at=at, bus=body.bus, unit=body.unit, key=key)
    written = await shifts.write(person, shifts.shift_at(at), new)
    response.headers.update(shifts.quota.rate_limit(person.sender).headers)
    return notes_json([written])[0]

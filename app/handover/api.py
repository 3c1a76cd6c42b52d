"""Shifts over HTTP: the list, the sheet of one, and its notes."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Header, Path, Query
from pydantic import AwareDatetime, Field
from starlette.responses import Response
from typing_extensions import TypedDict

from app.handover.rules.shift_times import Shift
from app.handover.service import Handover, NewNote, ShiftSummary
from app.handover.sheet import ShiftNoteShown, ShiftSheetShown, notes_json
from app.web.access import Operator, Viewer
from app.web.api_route import ApiRoute
from app.web.services import service
from app.web.shape import StrictBody, iso
from app.web.turns import SEARCH
from bus.instants import UnixTime
from bus.text import Lines, OneLine

router = APIRouter(prefix="/api/v1/shifts", tags=["shifts"], route_class=ApiRoute)

LONGEST_NOTE = 2000
MOST_SHIFTS = 100
Shifts = Annotated[Handover, service(Handover)]
NoteText = Annotated[Lines, Field(min_length=1, max_length=LONGEST_NOTE)]
RepeatKey = Annotated[str | None, Header(alias="Idempotency-Key", min_length=1, max_length=200)]


async def _shift_of(
    shifts: Shifts,
    start: Annotated[AwareDatetime, Path(description="When it starts. ISO 8601 with zone.")],
) -> Shift:
    return shifts.shift_of(start)


ShiftOfPath = Annotated[Shift, Depends(_shift_of)]


class ShiftNoteBody(StrictBody):
    """A note. Without ``time`` it is about now."""

    text: NoteText
    time: Annotated[
        AwareDatetime | None, Field(strict=False, description="In the shift, not in the future; with zone.")
    ] = None
    bus: Annotated[OneLine, Field(max_length=80)] | None = None
    unit: Annotated[int | None, Field(ge=1, le=255)] = None
    alarm: Annotated[OneLine, Field(max_length=300, description="The id of an occurrence.")] | None = None
    corrects: Annotated[
        int | None, Field(ge=1, le=2**62, description="The note to correct; it stays as it is.")
    ] = None


class ShiftSummaryShown(TypedDict):
    """A shift in the list."""

    start: str
    end: str
    notes: Annotated[int, Field(description="How many it has.")]


class ShiftsShown(TypedDict):
    """Shifts, newest first. ``next`` is the ``before`` of the next page."""

    shifts: list[ShiftSummaryShown]
    next: str


@router.get("")
async def get_shifts(
    _: Viewer,
    shifts: Shifts,
    before: AwareDatetime | None = None,
    limit: Annotated[int, Query(ge=1, le=MOST_SHIFTS)] = 30,
) -> ShiftsShown:
    """The shift under way and those before it."""
    found = await shifts.summaries(UnixTime(before.timestamp()) if before else None, limit)
    return {"shifts": [_summary(each) for each in found], "next": iso(found[-1].shift.start)}


@router.get("/{start}", response_model=ShiftSheetShown, dependencies=[SEARCH])
async def get_shift_sheet(_: Viewer, shifts: Shifts, shift: ShiftOfPath) -> Response:
    """The sheet of a shift, made of what is stored; of the one under way, up to now."""
    return Response(await shifts.sheet(shift), media_type="application/json")


@router.post("/{start}/notes", status_code=201)
async def write_shift_note(
    person: Operator, shifts: Shifts, shift: ShiftOfPath, body: ShiftNoteBody, key: RepeatKey = None
) -> ShiftNoteShown:
    """Write a note. It is never changed; a correction is a new note that names it."""
    new = NewNote(
        text=body.text,
        at=UnixTime(body.time.timestamp()) if body.time else None,
        bus=body.bus,
        unit=body.unit,
        alarm=body.alarm,
        corrects=body.corrects,
        key=key,
    )
    return notes_json([await shifts.write(person, shift, new)])[0]


def _summary(summary: ShiftSummary) -> ShiftSummaryShown:
    return {"start": iso(summary.shift.start), "end": iso(summary.shift.end), "notes": summary.notes}

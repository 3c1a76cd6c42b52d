"""``GET /api/v1/events``: JSON by pages and complete CSV."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Iterator
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel, Field
from starlette.responses import Response, StreamingResponse

from app.core.messages import Language
from app.core.web.access import Admin, Viewer
from app.core.web.api import ApiRoute
from app.core.web.csv_file import CSV, Cell, Column, CsvForm, WantedCsv, number_or_text
from app.core.web.routes import DOWNLOAD, SEARCH
from app.core.web.services import service
from app.core.web.shape import Instant, MaybeInstant, ZonedTime, attachment, iso, json_response
from app.people.audit.anchor import Anchoring
from app.people.audit.entry import EventKind, is_moment
from app.people.audit.log import Event, EventLog, Filter
from app.people.audit.proof import AuditVerification
from bus.instants import UnixTime
from bus.messages import term
from bus.validation import TypedText

router = APIRouter(prefix="/api/v1", tags=["events"], route_class=ApiRoute)
MAX_EVENTS = 1000
"""The most events that one page holds."""

CSV_COLUMNS = (
    *(Column("id", term("Number")), Column("time", term("Time"), is_time=True), Column("kind", term("Kind"))),
    *(Column("who", term("Who")), Column("origin", term("Origin")), Column("bus", term("Bus"))),
    *(Column("unit", term("Unit")), Column("what", term("What")), Column("old", term("Old"))),
    *(Column("new", term("New")), Column("old_raw", term("Old, raw")), Column("new_raw", term("New, raw"))),
    *(Column("outcome", term("Result")), Column("message", term("Note")), Column("count", term("Times"))),
)
COLUMNS = tuple(column.name for column in CSV_COLUMNS)


class EventMessage(BaseModel):
    """A text as data. A value that is a message has code and params too."""

    code: str
    params: dict[str, Any]


class EventFrame(BaseModel):
    """A frame that carried a command."""

    at: Annotated[Instant, Field(description="ISO 8601 in UTC, milliseconds.")]
    direction: Annotated[str, Field(description="out: a request, in: a response.")]
    data: Annotated[str, Field(description="The bytes on the wire, hexadecimal.")]
    meaning: Annotated[str, Field(description="Its meaning, English.")]
    meanings: Annotated[list[EventMessage], Field(description="meaning as data; none in older events.")] = []


class EventShown(BaseModel):
    """An event; ``outcome`` of a command is null until it is known. ``count``: how often it happened.
    ``unreadable``: its time (then null), frames or messages are not what the server wrote."""

    id: int
    time: Annotated[MaybeInstant, Field(description="ISO 8601 in UTC, milliseconds; null: not readable.")]
    kind: str
    who: str
    origin: Annotated[str, Field(description="Which way it came: page, api, command line, restore …")]
    bus: str | None
    unit: Annotated[int | None, Field(description="Address of the unit (#17), 1 to 255.")]
    what: str
    old: Annotated[str | None, Field(description="Value before, as shown to people.")]
    new: Annotated[str | None, Field(description="Value after, as shown to people.")]
    old_raw: Annotated[int | None, Field(description="Value before, integer on the wire.")]
    new_raw: Annotated[int | None, Field(description="Value after, integer on the wire.")]
    outcome: str | None
    message: str
    frames: list[EventFrame]
    count: Annotated[int, Field(description="How often it happened.")]
    unreadable: Annotated[
        bool, Field(description="Its time, frames or messages are not what the server wrote.")
    ]
    messages: Annotated[
        dict[str, EventMessage],
        Field(description="The texts of what, old, new and message as data, by field; none in older events."),
    ]


class EventPage(BaseModel):
    """The events, newest first. ``next`` is the ``before`` of the next page, null at the end."""

    events: list[EventShown]
    next: int | None


Events = Annotated[EventLog, service(EventLog)]
EntryNumber = Annotated[int | None, Query(ge=1, le=2**62)]


async def wanted_events(
    before: EntryNumber = None,
    kind: Literal[EventKind, ""] | None = None,
    bus: str | None = None,
    unit: Annotated[int | None, Query(ge=1, le=255)] = None,
    who: TypedText | None = None,
    since: Annotated[ZonedTime | None, Query(alias="from")] = None,
    until: Annotated[ZonedTime | None, Query(alias="to")] = None,
    search: Annotated[TypedText, Query(max_length=200)] = "",
) -> Filter:
    """Return the filter of the query."""
    begin = UnixTime(since.timestamp()) if since else None
    end = UnixTime(until.timestamp()) if until else None
    return Filter(before, kind or None, bus or None, unit, who or None, begin, end, search)


Wanted = Annotated[Filter, Depends(wanted_events)]


def shown(event: Event) -> dict[str, Any]:
    """Return an event in the form of the API."""
    return {
        **{name: event[name] for name in (*COLUMNS, "unreadable", "messages")},
        "time": iso(event["time"]) if is_moment(event["time"]) else None,
        "count": event["count"] or 1,
        "frames": [{**frame, "at": iso(frame["at"])} for frame in json.loads(event["frames"])],
    }


@router.get("/events", response_model=EventPage, dependencies=[SEARCH])
async def list_events(
    _: Viewer, events: Events, wanted: Wanted, limit: Annotated[int, Query(ge=1, le=MAX_EVENTS)] = 100
) -> Response:
    """List events, newest first: at most 1000 a page; ``next`` is ``before`` of the next page. Times with
    zone."""
    found, after = await events.page(wanted, limit)
    return await json_response(lambda: {"events": [shown(event) for event in found], "next": after})


@router.get("/events/proof", dependencies=[DOWNLOAD])
async def verify_audit_log(
    _: Admin, anchoring: Annotated[Anchoring, service(Anchoring)]
) -> AuditVerification:
    """Verify the complete log like ``lineside audit verify``, but only with the newest line of the anchor."""
    return await anchoring.verify()


@router.get("/events.csv", response_class=StreamingResponse, responses=CSV, dependencies=[DOWNLOAD])
async def export_events(_: Viewer, events: Events, wanted: Wanted, form: WantedCsv) -> StreamingResponse:
    """Export every event of the filter of GET /events, as CSV with a line of headings."""
    text = _csv(events, wanted, form)
    return StreamingResponse(text, headers=attachment("events.csv"), media_type="text/csv")


async def _csv(events: EventLog, wanted: Filter, form: CsvForm) -> AsyncIterator[str]:
    yield form.head(CSV_COLUMNS)
    async for chunk in events.every(wanted):
        yield await asyncio.to_thread(
            form.rows, CSV_COLUMNS, [list(_cells(event, form.language)) for event in chunk]
        )


def _cells(event: Event, language: Language | None) -> Iterator[Cell]:
    """Yield the cells of an event in a row; for a reader as the page of the events shows them."""
    event = {**event, "count": event["count"] or 1}
    for name in COLUMNS:
        if name == "time":
            yield datetime.fromtimestamp(event["time"], UTC) if is_moment(event["time"]) else None
        elif language is None or event[name] is None:
            yield event[name]
        elif name in event["messages"]:
            yield number_or_text(language.t(event["messages"][name]))
        elif name in ("kind", "origin", "outcome"):
            yield language.t(event[name].replace("_", " ") if name == "kind" else event[name])
        else:
            yield number_or_text(event[name]) if name in ("old", "new") else event[name]

"""``GET /line``, the buses, the units and ``GET /stream``: the live state over HTTP."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Query
from starlette.requests import HTTPConnection
from starlette.responses import StreamingResponse

from app.core.server.addresses import source_of
from app.core.web.access import Viewer
from app.core.web.api import ApiRoute
from app.core.web.services import service
from app.errors import Problem
from app.line.live.api.schemas import BusShown, BusStatistics, Line, UnitShown
from app.line.live.api.stream import LineStream
from app.line.live.api.view import LineView, figures_json
from app.line.live.bus_live import LiveState
from app.line.live.requests import bus_or_404, unit_or_404
from bus.instants import unix_now
from bus.messages import Message

router = APIRouter(prefix="/api/v1", tags=["line"], route_class=ApiRoute)
Live = Annotated[LiveState, service(LiveState)]
LineViewService = Annotated[LineView, service(LineView)]


@router.get("/line", response_model=Line)
async def get_line(_: Viewer, view: LineViewService) -> dict[str, Any]:
    """Current state of every bus and unit. ``history``: why no values are stored, null while they are."""
    return view.line(unix_now())


@router.get("/buses/{bus}", response_model=BusShown)
async def get_bus(_: Viewer, view: LineViewService, bus: str) -> dict[str, Any]:
    """One bus with its units."""
    bus_or_404(view.live, bus)
    return view.bus(bus, unix_now())


@router.get("/buses/{bus}/units/{unit:int}", response_model=UnitShown)
async def get_unit(_: Viewer, view: LineViewService, bus: str, unit: int) -> dict[str, Any]:
    """One unit, with the age of its values."""
    unit_or_404(view.live, bus, unit)
    return view.unit(bus, unit, unix_now())


@router.get("/buses/{bus}/figures", response_model=BusStatistics)
async def get_bus_statistics(_: Viewer, live: Live, bus: str) -> dict[str, Any]:
    """Wire load of a bus, and the counters of each unit since its worker started."""
    return figures_json(bus, bus_or_404(live, bus).figures)


EVENT_STREAM = "text/event-stream"
TEXT = {
    "type": "string",
    "description": "The events of GET /asyncapi.json, an empty line after each.",
}
EVENTS: dict[int | str, dict[str, Any]] = {200: {"content": {EVENT_STREAM: {"schema": TEXT}}}}
MAX_SECONDS = 3600
SECONDS: dict[str, Any] = {
    "parameters": [
        {
            "name": "seconds",
            "in": "query",
            "required": True,
            "schema": {"type": "integer", "minimum": 1, "maximum": MAX_SECONDS, "default": 10},
            "description": "Ends the response after this time. A generated call reads a response to its end "
            "and has to give it; without it, as EventSource requests it, the response has no end.",
        }
    ]
}
"""Required only in the document, as a generated call would otherwise never return."""
Stream = Annotated[LineStream, service(LineStream)]


async def _admitted(connection: HTTPConnection, person: Viewer, stream: Stream) -> AsyncIterator[None]:
    """Count a reader until its response has ended. Raises Problem 429."""
    address = source_of(connection.client.host if connection.client else "")
    if not stream.admission.enter(person.account, address):
        raise Problem(429, "too_many", Message("too_many_streams")).with_headers(Retry_After="10")
    try:
        with stream.reading():
            yield
    finally:
        stream.admission.leave(person.account, address)


@router.get(
    "/stream",
    response_class=StreamingResponse,
    responses=EVENTS,
    dependencies=[Depends(_admitted)],
    openapi_extra=SECONDS,
)
async def get_stream(
    _: Viewer,
    live: Live,
    stream: Stream,
    bus: str | None = None,
    seconds: Annotated[int | None, Query(ge=1, le=MAX_SECONDS, include_in_schema=False)] = None,
    last_event_id: Annotated[str, Header(description="Resumes after this event.")] = "",
) -> StreamingResponse:
    """Server-Sent Events, without end unless ``seconds`` are given: a ``snapshot`` (as GET /line), then each
    ``change`` (``bus``, ``unit`` and its fields that changed; ``unit`` null: of the bus itself), ``alarm``
    (as in GET /alarms) and, every 5 s, a ``heartbeat``. A client that cannot resume, or reads too slowly,
    gets a ``snapshot`` in place of what it missed. ``bus``: only of this bus and of the site.
    """
    if bus is not None:
        bus_or_404(live, bus)
    # A proxy would collect a response before it passes it on.
    headers = {"X-Accel-Buffering": "no"}
    return StreamingResponse(
        stream.pieces(bus, last_event_id, seconds), headers=headers, media_type=EVENT_STREAM
    )

"""``GET /line``, the buses and the units: the live state."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter
from starlette.requests import HTTPConnection

from app.live.api.figures import BusStatistics, figures_json
from app.live.api.schemas import BusShown, Line, UnitShown
from app.live.api.view import LineView
from app.live.lookup import bus_or_404, unit_or_404
from app.live.state.bus_live import LiveState
from app.routing.other_lines import OtherLines
from app.web.admission.access import Viewer
from app.web.api.route import ApiRoute
from app.web.services import service
from bus.instants import unix_now

router = APIRouter(prefix="/api/v1", tags=["line"], route_class=ApiRoute)
Live = Annotated[LiveState, service(LiveState)]
LineViewService = Annotated[LineView, service(LineView)]
OtherLinesService = Annotated[OtherLines, service(OtherLines)]


@router.get("/line", response_model=Line)
async def get_line(
    connection: HTTPConnection, _: Viewer, view: LineViewService, others: OtherLinesService
) -> dict[str, Any]:
    """Current state of every bus and unit, also of those at other servers. ``history``: why no values are
    stored, null while they are. ``elsewhere``: the buses whose home did not respond within a second."""
    found = await others.responses(connection)
    buses = {
        bus["name"]: bus
        for response in found
        for bus in response.body.get("buses", ())
        if bus["name"] in response.places
    }
    return view.line(unix_now(), others=buses)


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

"""``GET /line``, the buses and the units: the live state."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter

from app.core.web.admission.access import Viewer
from app.core.web.api.route import ApiRoute
from app.core.web.services import service
from app.line.live.api.figures import BusStatistics, figures_json
from app.line.live.api.schemas import BusShown, Line, UnitShown
from app.line.live.api.view import LineView
from app.line.live.lookup import bus_or_404, unit_or_404
from app.line.live.state.bus_live import LiveState
from bus.instants import unix_now

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

"""``GET /line``, the buses and the units: the live state."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter
from starlette.requests import HTTPConnection

from app.live.api.figures import BusStatistics, figures_json
from app.live.api.schemas import BusShown, Line, UnitShown
from app.live.api.view import bus_json, line_json, unit_json
from app.live.lookup import bus_or_404, unit_or_404
from app.live.screen.fields import Translator
from app.live.screen.sources import Sources
from app.live.state.bus_live import LiveState
from app.messages import DEFAULT
from app.settings import Settings
from app.web.access import Viewer
from app.web.api_route import ApiRoute
from app.web.services import looked_up, service
from app.web.templating import templates_of
from bus.instants import unix_now

router = APIRouter(prefix="/api/v1", tags=["line"], route_class=ApiRoute)


def english_of(connection: HTTPConnection) -> Translator:
    """What texts for programs are written with."""
    templates = templates_of(connection)
    return Translator(templates.languages[DEFAULT], templates.formats(DEFAULT))


English = Annotated[Translator, looked_up(english_of)]
Live = Annotated[LiveState, service(LiveState)]
LineSources = Annotated[Sources, service(Sources)]
Configured = Annotated[Settings, service(Settings)]


@router.get("/line", response_model=Line)
async def get_line(
    _: Viewer, live: Live, settings: Configured, sources: LineSources, english: English
) -> dict[str, Any]:
    """Current state of every bus and unit. ``history``: empty, or why no values are stored."""
    blocks, fault = {bus: of.block_reason for bus, of in sources.guards.items()}, sources.history_fault()
    return line_json(settings.site.name, live.buses, unix_now(), blocks, fault, english)


@router.get("/buses/{bus}", response_model=BusShown)
async def get_bus(_: Viewer, live: Live, sources: LineSources, english: English, bus: str) -> dict[str, Any]:
    """One bus with its units."""
    found = bus_or_404(live, bus)
    return bus_json(found, unix_now(), sources.guards[bus].block_reason, english)


@router.get("/buses/{bus}/units/{unit:int}", response_model=UnitShown)
async def get_unit(
    _: Viewer, live: Live, sources: LineSources, english: English, bus: str, unit: int
) -> dict[str, Any]:
    """One unit, with the age of its values."""
    found = unit_or_404(live, bus, unit)
    return unit_json(live.buses[bus], found, unix_now(), sources.guards[bus].block_reason, english)


@router.get("/buses/{bus}/figures", response_model=BusStatistics)
async def get_bus_statistics(_: Viewer, live: Live, bus: str) -> dict[str, Any]:
    """Wire load of a bus, and the counters of each unit since its worker started."""
    return figures_json(bus, bus_or_404(live, bus).figures)

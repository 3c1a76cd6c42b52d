"""The page of the line. Texts and positions come from the hub's screen, as in the browser."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from itertools import groupby
from typing import Annotated, Any, Literal

from fastapi import APIRouter
from pydantic import BeforeValidator
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.web.access import Engineer, Viewer, cookie_of, set_cookie
from app.core.web.routes import GuardedRoute
from app.core.web.services import service_of
from app.core.web.templating import LINES, PageLines, render, templates_of
from app.line.live.bus_live import BusLive, UnitLive
from app.line.live.fields import unit_key
from app.line.live.hub import Hub
from app.line.live.requests import bus_or_404
from bus.catalogue.parameters import AT_SPEED_WINDOW, DECIMALS, MAX_DISPLAY
from bus.settings import UnitLabels

FirstStep = Literal["worker", "port", "scan"]
"""The missing part: the bus worker, its port, or a unit that responds."""


def next_step(bus: BusLive) -> FirstStep | None:
    """Return the first missing part of a bus; None once a unit responds or has responded before."""
    if any(unit.reading or unit.last_response for unit in bus.units.values()):
        return None
    if not bus.worker_connected:
        return "worker"
    return "scan" if bus.link.link == "open" else "port"


router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

View = Literal["tiles", "rows", "matrix"]
FORMER_VIEWS = {"board": "matrix"}
"""The present name of each former view; a stored home page or cookie may have it."""
ViewSize = Annotated[
    Literal["auto", "tiles", "rows", "matrix"],
    BeforeValidator(lambda view: FORMER_VIEWS.get(view, view)),
]
MAX_TILES = 24
VIEW_COOKIE = "lineside_view"
YEAR_S = 365 * 24 * 3600


@dataclass(frozen=True, slots=True)
class UnitOnLine:
    """The fixed properties of a unit while a page is open. ``pad``: places that align the decimals;
    ``window``: its at-speed window in the unit of its speed, empty if that is not known."""

    key: str
    id: int
    name: str
    unit: str
    digits: int
    pad: int
    labels: UnitLabels
    window: str

    @property
    def href(self) -> str:
        return f"/units/{self.key}"


@dataclass(frozen=True, slots=True)
class Group:
    """A group of units that stand together on the floor."""

    name: str
    units: list[UnitOnLine]


@dataclass(frozen=True, slots=True)
class BusOnLine:
    """A bus and its groups in floor order."""

    name: str
    port: str
    groups: list[Group]


@router.get("/")
async def line(request: Request, _: Viewer, view: ViewSize | None = None) -> Response:
    """Show every unit in floor order, the abnormal ones first; a server that has only peers shows their
    lines."""
    if service_of(request, PageLines).is_overview:
        return RedirectResponse(LINES.href, 303)
    hub = service_of(request, Hub)
    screen = hub.screen(templates_of(request).language_of(request).tag)
    chosen = view or _remembered(request)
    buses = [_bus_on_line(name, bus) for name, bus in hub.live.buses.items()]
    count = sum(len(group.units) for bus in buses for group in bus.groups)
    response = render(
        request,
        "line/page.html",
        fields=screen.flat(),
        first_steps=[guide for bus in hub.live.buses.values() if (guide := _first_steps(bus))["step"]],
        buses=buses,
        unit_count=count,
        most_tiles=MAX_TILES,
        view=view_for(count) if chosen == "auto" else chosen,
        chosen=chosen,
    )
    if view is not None:
        set_cookie(request, response, VIEW_COOKIE, view, YEAR_S)
    return response


@router.get("/bus/{bus}/first-steps")
async def first_steps(request: Request, _: Engineer, bus: str) -> Response:
    """Show what to do until the first unit of a bus responds, and then the line."""
    guide = _first_steps(bus_or_404(service_of(request, Hub).live, bus))
    if guide["step"] is None:
        return Response(headers={"HX-Redirect": "/"})
    return render(request, "line/_first_steps.html", **guide)


def _first_steps(bus: BusLive) -> dict[str, Any]:
    return {"bus": bus.settings, "baud": bus.baud, "step": next_step(bus)}


def view_for(units: int) -> View:
    """Return the view that shows as much as the number of units allows."""
    return "tiles" if units <= MAX_TILES else "matrix"


def unit_on_line(bus: str, unit: UnitLive, most_decimals: int = 0) -> UnitOnLine:
    """Return a unit in the form that the templates take."""
    settings = unit.settings
    decimals, window = unit.parameter_raw(DECIMALS) or 0, unit.parameter_raw(AT_SPEED_WINDOW)
    return UnitOnLine(
        key=unit_key(bus, settings.id),
        id=settings.id,
        name=settings.name,
        unit=settings.labels.unit,
        digits=digits_of(unit),
        pad=max(0, most_decimals - decimals),
        labels=settings.labels,
        window="" if window is None else f"{Decimal(window).scaleb(-decimals)}",
    )


def digits_of(unit: UnitLive) -> int:
    """Return the width of the highest speed of a unit in characters, its decimal sign included."""
    decimals = unit.parameter_raw(DECIMALS) or 0
    span = unit.parameter_raw(MAX_DISPLAY) or 99999
    return max(len(str(span)), decimals + 1) + (1 if decimals else 0)


def _remembered(request: Request) -> ViewSize:
    stored = cookie_of(request, VIEW_COOKIE)
    match FORMER_VIEWS.get(stored, stored):
        case ("tiles" | "rows" | "matrix") as view:
            return view
    return "auto"


def _bus_on_line(name: str, bus: BusLive) -> BusOnLine:
    most = max((unit.parameter_raw(DECIMALS) or 0 for unit in bus.units.values()), default=0)
    units = ((unit.settings.group, unit_on_line(name, unit, most)) for unit in bus.units.values())
    return BusOnLine(name, bus.settings.port, list(_groups(units)))


def _groups(units: Iterable[tuple[str, UnitOnLine]]) -> Iterator[Group]:
    for name, members in groupby(units, key=lambda pair: pair[0]):
        yield Group(name, [unit for _, unit in members])

"""The wallboard: one line at a time, to be read across the hall, without navigation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from app.live.browsers.hub import Hub
from app.live.pages import UnitOnLine, unit_on_line
from app.live.screen.fields import Translator
from app.sites.fleet import FleetLookup
from app.sites.tile import line_key
from app.web.admission.access import Viewer
from app.web.rendering.templating import render, templates_of
from app.web.services import service_of, unknown_bus

router = APIRouter(include_in_schema=False)
Size = Literal["large", "medium", "small", "tiny"]
MAX_OF: dict[Size, int] = {"large": 12, "medium": 24, "small": 54, "tiny": 255}
"""Up to how many sections of a line each is shown with its speed; with its name only; as a roll, in up to
three rows; in more."""


@dataclass(frozen=True, slots=True)
class LineOnWall:
    """What of a line does not change while the page is open. ``units``: its sections in floor order."""

    bus: str
    key: str
    units: list[UnitOnLine]
    measure: str

    @property
    def size(self) -> Size:
        """How much of each section has room."""
        return next(size for size, most in MAX_OF.items() if len(self.units) <= most)


@router.get("/wallboard")
async def wallboard_page(request: Request, _: Viewer, fleet: FleetLookup, bus: str = "") -> Response:
    """Every line in turn, or only that of ``bus``. Raises Problem 404."""
    templates, hub = templates_of(request), service_of(request, Hub)
    language = templates.language_of(request).on_screen
    reported = fleet.board.lines()
    names = list(hub.live.buses)
    if bus and bus not in names:
        raise unknown_bus(bus, names)
    return render(
        request,
        "wallboard/page.html",
        lines=[_on_wall(hub, name) for name in names if bus in ("", name)],
        names=names,
        chosen=bus,
        tiles=fleet.fields_of(reported, Translator(language, templates.formats(language.tag))),
        fields=hub.screen(language.tag).flat(),
    )


def _on_wall(hub: Hub, name: str) -> LineOnWall:
    units = [unit_on_line(name, unit) for unit in hub.live.buses[name].units.values()]
    return LineOnWall(name, line_key(name), units, units[0].unit if units else "")

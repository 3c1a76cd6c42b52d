"""The page of all lines."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from app.live.screen.fields import Translator
from app.sites.fleet import FleetLookup
from app.sites.tile import line_key
from app.web.admission.access import Viewer
from app.web.rendering.templating import render, templates_of

router = APIRouter(include_in_schema=False)


@router.get("/lines")
async def lines_page(request: Request, _: Viewer, fleet: FleetLookup, site: str = "") -> Response:
    """Every line, the worst first; ``site``: only of this one, where there is one of its
    name."""
    templates = templates_of(request)
    language = templates.language_of(request).on_screen
    translator = Translator(language, templates.formats(language.tag))
    lines = fleet.board.lines()
    sites = sorted({line.summary.site for line in lines if line.summary is not None})
    chosen = site if site in sites else ""
    shown: list[dict[str, Any]] = [
        {"bus": line.bus, "site": line.summary.site if line.summary else "", "key": line_key(line.bus)}
        for line in lines
        if not chosen or (line.summary is not None and line.summary.site == chosen)
    ]
    return render(
        request,
        "lines/page.html",
        lines=shown,
        tiles=fleet.fields_of(lines, translator),
        sites=sites,
        chosen=chosen,
    )

"""The trends page. What it shows is in its address, so that a link reopens the same view."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from app.history.api.spans import HistoryOf
from app.history.export import parquet_file
from app.history.pages.preload import preload_address
from app.history.query import labels
from app.history.series.runs import micros
from app.history.series.values import VALUES
from app.history.service import History
from app.history.status import store_notice
from app.web.access import Viewer
from app.web.templating import render, templates_of
from bus.instants import unix_now

router = APIRouter(include_in_schema=False)


@router.get("/trends")
async def trends(request: Request, _: Viewer, history: HistoryOf) -> Response:
    """Any values of any units over any span; the browser draws what its address names."""
    templates = templates_of(request)
    language = templates.language_of(request)
    return render(
        request,
        "trends/page.html",
        catalogue=_catalogue(history),
        values=VALUES,
        has_parquet=parquet_file.is_installed(),
        memory=store_notice(history.status, templates.formats(language.tag), unix_now()),
        preload=preload_address(history, request.query_params, micros(unix_now())),
    )


def _catalogue(history: History) -> list[dict[str, Any]]:
    """Every unit in floor order, with its wiring and its measure."""
    return [
        {
            "key": f"{bus.name}/{unit.id}",
            "name": unit.name,
            "bus": bus.name,
            "labels": {name: text for name, value in VALUES.items() if (text := labels.label(unit, value))},
            "measures": {"speed": unit.labels.unit, "analog": unit.labels.analog_unit},
        }
        for bus in history.buses.values()
        for unit in bus.unit
    ]

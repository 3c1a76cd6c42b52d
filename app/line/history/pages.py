"""The trends page. Its address holds what it shows, so that a link reopens the same view."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from itertools import islice
from typing import Annotated, Any

from fastapi import APIRouter, Form, Path
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.web.access import Person, Viewer
from app.core.web.assets import Assets
from app.core.web.services import service, service_of
from app.core.web.templating import Templates, render, templates_of
from app.errors import Problem, StoreError
from app.line.history.export import has_parquet
from app.line.history.series import values
from app.line.history.series.runs import DAY, micros
from app.line.history.series.values import VALUES
from app.line.history.service import History
from app.line.history.spans import HistoryOf, Span, series_queries
from app.line.history.status import store_notice
from app.line.history.views import MAX_QUERY, TrendView, TrendViews
from app.people.audit.api import Events
from app.settings import Settings
from bus.instants import unix_now
from bus.validation import OneLine

router = APIRouter(include_in_schema=False)
SEE_OTHER = 303
SavedViews = Annotated[TrendViews, service(TrendViews)]


@router.get("/trends")
async def trends(request: Request, person: Viewer, history: HistoryOf, views: SavedViews) -> Response:
    """Any values of any units over any span; the browser draws what its address names."""
    templates = templates_of(request)
    language = templates.language_of(request)
    return render(
        request,
        "trends/page.html",
        catalogue=_catalogue(history),
        words={name: values.text(value, language.t) for name, value in VALUES.items()},
        has_parquet=has_parquet(),
        memory=store_notice(history.status, templates.formats(language.tag), unix_now()),
        shift_starts=service_of(request, Settings).shift.minutes,
        views=await _views_seen(views, person),
    )


async def _views_seen(views: TrendViews, person: Person) -> list[TrendView]:
    """Return the saved views of a person; none where the store cannot be read, as the chart does without
    them."""
    try:
        return await views.seen_by(person)
    except StoreError:
        return []


@router.post("/trends/views")
async def save_view(
    person: Viewer,
    views: SavedViews,
    events: Events,
    name: Annotated[OneLine, Form(max_length=200)] = "",
    query: Annotated[OneLine, Form(max_length=MAX_QUERY)] = "",
    shared: Annotated[bool, Form()] = False,
) -> Response:
    """Save what is shown under a name; an operator may share it with everyone."""
    address = await views.save(person, events, name, query, shared=shared)
    return RedirectResponse(f"/trends?{address}#trend-save", SEE_OTHER)


@router.post("/trends/views/{number}/delete")
async def delete_view(
    person: Viewer, views: SavedViews, events: Events, number: Annotated[int, Path(ge=1, le=2**62)]
) -> Response:
    """Delete a saved view."""
    await views.delete(person, events, number)
    return RedirectResponse("/trends", SEE_OTHER)


def _catalogue(history: History) -> list[dict[str, Any]]:
    """Every unit in floor order, with its wiring and its measure."""
    return [
        {
            "key": f"{bus.name}/{unit.id}",
            "name": unit.name,
            "bus": bus.name,
            "labels": {name: text for name, value in VALUES.items() if (text := values.label(unit, value))},
            "measures": {"speed": unit.labels.unit, "analog": unit.labels.analog_unit},
        }
        for bus in history.buses.values()
        for unit in bus.unit
    ]


DEFAULT_VALUES = 8


def usual_series(history: History) -> list[str]:
    """The series that the page shows while its address names none."""
    units = (f"{bus.name}/{unit.id}" for bus in history.buses.values() for unit in bus.unit)
    return [f"{unit}/actual" for unit in islice(units, DEFAULT_VALUES)]


AFTER_S = 1.0
"""Later than the start itself, which needs the machine: a person takes longer to find the page."""
POINTS = 1000
_SHELL = ("base.html", "components/", "trends/")


async def warm(history: History, templates: Templates, assets: Assets, language: str) -> None:
    """Read the catalog of ``language``, the site's, and compile the others, compress static files, load the
    frame of the pages and the trends page, query a day of history: one after the other, to keep the line
    responsive."""
    await asyncio.sleep(AFTER_S)
    await asyncio.to_thread(templates.languages[language].read)
    for each in templates.languages:
        await asyncio.to_thread(each.compile)
    for name in assets:
        await asyncio.to_thread(assets.pack, name)
    environment = templates.environment(language)
    for name in environment.list_templates(filter_func=lambda name: name.startswith(_SHELL)):
        await asyncio.to_thread(environment.get_template, name)
    now = micros(unix_now())
    with suppress(Problem, StoreError):
        await history.query(series_queries(history, usual_series(history), Span(now - DAY, now), POINTS))

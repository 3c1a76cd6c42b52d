"""Work that the first page after a start would wait for, done in advance."""

from __future__ import annotations

import asyncio

from app.errors import Problem, StoreError
from app.history.api.spans import Span, series_queries
from app.history.pages.preload import usual_series
from app.history.series.runs import DAY, micros
from app.history.service import History
from app.web.assets import Assets
from app.web.templating import Templates
from bus.instants import unix_now

AFTER_S = 1.0
"""Later than the start itself, which needs the machine: a person takes longer to find the page."""
POINTS = 1000
_SHELL = ("base.html", "components/", "trends/")


async def warm(history: History, templates: Templates, assets: Assets, language: str) -> None:
    """Read the catalogs, compress static files, load the frame of the pages and the trends page, query a day
    of history: one after the other, to keep the line responsive. ``language``: the site's."""
    await asyncio.sleep(AFTER_S)
    for each in (templates.languages[language], *templates.languages):
        await asyncio.to_thread(each.read)
    for name in assets:
        await asyncio.to_thread(assets.pack, name)
    environment = templates.environment(language)
    for name in environment.list_templates(filter_func=lambda name: name.startswith(_SHELL)):
        await asyncio.to_thread(environment.get_template, name)
    await _query_a_day(history)


async def _query_a_day(history: History) -> None:
    now = micros(unix_now())
    names = usual_series(history)
    try:
        await history.query(series_queries(history, names, Span(now - DAY, now), POINTS))
    except (Problem, StoreError):
        return

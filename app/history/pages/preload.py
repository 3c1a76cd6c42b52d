"""The data that the trends page fetches first, requested by the page while its scripts are on the way.

The rules for an address are those of ``static/js/trends-view.js``; where they differ, it requests again.
"""

from __future__ import annotations

from itertools import islice
from urllib.parse import urlencode

from starlette.datastructures import QueryParams

from app.errors import Problem
from app.history.api.routes import iso
from app.history.api.spans import MOST_SERIES, Span, moment
from app.history.series.runs import SECOND
from app.history.series.values import VALUES
from app.history.service import History

DEFAULT_SPAN_S = 3600.0
DEFAULT_VALUES = 8


def preload_address(history: History, params: QueryParams, now: int) -> str:
    """The series that a page with this query draws at ``now`` (µs); empty where none can be named."""
    try:
        span = _span(params, now)
    except (Problem, ValueError, OverflowError):
        return ""
    names = _names(history, params)[:MOST_SERIES]
    if not names or span.start >= span.end:
        return ""
    query = [("from", iso(span.start)), ("to", iso(span.end)), ("format", "epoch")]
    return "/api/v1/history/series?" + urlencode([*query, *(("series", name) for name in names)])


def _span(params: QueryParams, now: int) -> Span:
    length = round(float(params.get("span", DEFAULT_SPAN_S)) * SECOND)
    end = moment(params["to"], "to") if "to" in params else now
    return Span(moment(params["from"], "from") if "from" in params else end - length, end)


def usual_series(history: History) -> list[str]:
    """What the page shows while its address names nothing."""
    units = (f"{bus.name}/{unit.id}" for bus in history.buses.values() for unit in bus.unit)
    return [f"{unit}/actual" for unit in islice(units, DEFAULT_VALUES)]


def _names(history: History, params: QueryParams) -> list[str]:
    if "s" not in params:
        return usual_series(history)
    units = [f"{bus.name}/{unit.id}" for bus in history.buses.values() for unit in bus.unit]
    known = {f"{unit}/{value}" for unit in units for value in VALUES}
    return [name for name in params.getlist("s") if name in known]

"""``GET /api/v1/history`` and what goes with it. Every request names a span; limits are refused in words."""

from __future__ import annotations

from typing import Annotated, Any, Literal
from zoneinfo import ZoneInfo

from fastapi import APIRouter, Query, Response
from starlette.requests import Request
from starlette.responses import StreamingResponse

from app.audit.api import Events
from app.errors import Problem
from app.history import export as download
from app.history import spans
from app.history.export import ExportResolution, Format, Layout
from app.history.marks import marks_of, shown_mark, time_shown
from app.history.query import QueryResult, SeriesQuery, stored_queries
from app.history.schemas import EXPORT, HistoryMarks, HistorySeries, Sparkline, json_of
from app.history.series import values
from app.history.series.runs import SECOND
from app.history.service import seconds
from app.history.spans import HistoryOf, PointsOf, Span, SpanOf
from app.history.status import HistoryStatus
from app.web.admission.access import Viewer
from app.web.admission.turns import DOWNLOAD, SEARCH
from app.web.api.route import ApiRoute
from app.web.api.shape import iso, json_response
from app.web.rendering.csv_file import CsvForm, WantedCsv
from app.web.rendering.templating import templates_of
from bus.messages import Message

router = APIRouter(prefix="/api/v1/history", tags=["history"], route_class=ApiRoute)
SPARK_POINTS = 120
MAX_SPARKS = 255
TimeFormat = Annotated[Literal["iso", "epoch"], Query(alias="format")]


def shown(requested: SeriesQuery, found: QueryResult, times: str) -> dict[str, Any]:
    """A result as the API returns it."""
    unit = values.unit_settings(requested.bus, requested.unit)
    at = map(seconds, found.series.at)
    return {
        "bus": requested.bus.name,
        "unit": requested.unit,
        "value": requested.value.name,
        "measure": values.measure(unit, requested.value),
        "decimals": found.decimals,
        "from": iso(seconds(requested.start)),
        "to": iso(seconds(requested.end)),
        "resolution": found.resolution,
        "bucket_s": found.bucket / SECOND,
        "t": [time_shown(each, times) for each in at],
        "min": found.series.least,
        "max": found.series.greatest,
        "avg": found.series.average,
    }


@router.get("", response_model=None, responses=json_of(HistorySeries), dependencies=[SEARCH])
async def get_history(
    _: Viewer,
    history: HistoryOf,
    span: SpanOf,
    points: PointsOf,
    bus: str,
    unit: int,
    value: str,
    times: TimeFormat = "iso",
) -> Response:
    """One value of one unit over a span, in at most ``points`` (1 to 20 000, else 1000) points.

    Columns ``t``, ``min``, ``max``, ``avg`` in display units, with the decimals (#3) and the analog
    scale (#22, #23) as they were known at that time. Every reading itself (``bucket_s`` 0) where that
    fits; equal readings one after the other are given as the first and the last. A null between is a
    hole. ``format=epoch`` gives times in seconds since the epoch.
    """
    requested = spans.series_query(history, bus, unit, value, span, points)
    (found,) = await history.query([requested])
    return await json_response(lambda: shown(requested, found, times))


@router.get("/series", response_model=None, responses=json_of(list[HistorySeries]), dependencies=[SEARCH])
async def get_history_series(
    _: Viewer,
    history: HistoryOf,
    span: SpanOf,
    points: PointsOf,
    series: Annotated[list[str], Query()],
    times: TimeFormat = "iso",
) -> Response:
    """Several values at once, each named ``bus/unit/value`` (1 to 32): a list of what GET /history gives."""
    requested = spans.series_queries(history, series, span, points)
    found = await history.query(requested)
    return await json_response(lambda: [shown(q, a, times) for q, a in zip(requested, found, strict=True)])


@router.get("/sparks", response_model=None, responses=json_of(dict[str, Sparkline]), dependencies=[SEARCH])
async def get_sparklines(
    _: Viewer,
    history: HistoryOf,
    span: SpanOf,
    series: Annotated[list[str], Query()],
    times: TimeFormat = "iso",
) -> Response:
    """Sparklines of many units (up to 255): for each ``bus/unit/value`` the columns ``t`` and ``avg``, about
    120 points."""
    if len(series) > MAX_SPARKS:
        raise Problem(422, "invalid", Message.of("too_many_sparklines", most=MAX_SPARKS, count=len(series)))
    requested = [spans.named_series_query(history, name, span, SPARK_POINTS) for name in series]
    found = await history.query(requested)
    sparks = zip(series, found, strict=True)
    return await json_response(lambda: {name: _small(result, times) for name, result in sparks})


def _small(found: QueryResult, times: str) -> dict[str, Any]:
    return {"t": [time_shown(seconds(at), times) for at in found.series.at], "avg": found.series.average}


@router.get("/marks", response_model=None, responses=json_of(HistoryMarks), dependencies=[SEARCH])
async def get_history_marks(
    request: Request,
    _: Viewer,
    events: Events,
    span: SpanOf,
    unit: Annotated[list[str] | None, Query()] = None,
    times: TimeFormat = "iso",
) -> Response:
    """Events of a span, oldest first: events (setpoint changes too) of the site and of each
    ``bus/unit`` named, and the spans of readings that came late. At most the newest 500; ``more``: there
    were more. ``shown``: ``what``, ``old`` and ``new`` in the reader's language."""
    language = templates_of(request).language_of(request)
    found, more = await marks_of(events, seconds(span.start), seconds(span.end), unit)
    return await json_response(
        lambda: {"marks": [shown_mark(m, times, language) for m in found], "more": more}
    )


@router.get("/status")
async def get_history_status(_: Viewer, history: HistoryOf) -> HistoryStatus:
    """State of the history: ``state`` ok, low or scarce (little disk space), paused or failed; ``message``:
    what to do. The rest of Lineside works in every state."""
    return history.status


@router.get("/export", response_class=StreamingResponse, responses=EXPORT, dependencies=[DOWNLOAD])
async def export_history(
    request: Request,
    _: Viewer,
    history: HistoryOf,
    span: SpanOf,
    series: Annotated[list[str], Query()],
    file: Annotated[Format, Query(alias="format")] = "csv",
    resolution: ExportResolution = "auto",
    layout: Layout = "readings",
    *,
    form: WantedCsv,
) -> StreamingResponse:
    """CSV or Parquet of any span, streamed: ``series`` may be repeated, each ``bus/unit/value``. Of a draw
    the file has the two speeds that it is made of.

    ``resolution`` auto: values if they are stored for the complete span, else minutes. ``layout=table``, of
    CSV: one row a time (a second, or longer over a long span) with every value in force then, in local time,
    under the names of units in the reader's language; ``form=reader``: also with the separator and the
    decimal sign of that language.
    """
    requested = spans.series_queries(history, series, Span(span.start, span.end), 1)
    stored = [stored for each in requested for stored in stored_queries(each)]
    once = {(each.bus.name, each.unit, each.value.name): each for each in stored}
    if layout == "table" and form.language is None:
        form = CsvForm(templates_of(request).language_of(request), ZoneInfo(history.time_zone))
    return await download.response(history, list(once.values()), file, resolution, form, layout)

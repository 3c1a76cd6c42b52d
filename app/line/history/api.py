"""The routes below ``GET /api/v1/history``. Every request names a span, and may name values and a number of
points; a request beyond the limits is refused with the reason."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from operator import attrgetter
from typing import Annotated, Any, Literal, NamedTuple
from zoneinfo import ZoneInfo

from fastapi import APIRouter, Depends, Query, Response
from pydantic import Field, WithJsonSchema
from starlette.requests import Request
from starlette.responses import StreamingResponse
from typing_extensions import TypedDict

from app.core.messages import Language
from app.core.web.access import Viewer
from app.core.web.api import ApiRoute, problems
from app.core.web.csv_file import CsvForm, WantedCsv
from app.core.web.request_rules import refuse_year
from app.core.web.routes import DOWNLOAD, SEARCH
from app.core.web.services import service, unknown_bus, unknown_unit
from app.core.web.shape import (
    DATE_TIME,
    Instant,
    MessageShown,
    iso,
    json_response,
    message_shown,
    parse_integer,
)
from app.core.web.templating import templates_of
from app.errors import Problem
from app.line.history.export import ExportResolution, Format, Layout, export_response
from app.line.history.query import QueryResult, Resolution, SeriesQuery
from app.line.history.series import values
from app.line.history.series.runs import HOUR, SECOND, micros
from app.line.history.series.values import VALUES
from app.line.history.service import History, seconds
from app.line.history.status import HistoryStatus
from app.people.audit.api import Events
from app.people.audit.log import Event, EventLog, Filter
from bus.instants import UnixTime, unix_now
from bus.messages import Message

MAX_POINTS = 20_000
MAX_SERIES = 32
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_PLUS_LOST = re.compile(r"(:\d\d(?:\.\d+)?) (\d\d:?\d\d)$")


MaybeMomentText = Annotated[str, Field(max_length=40), WithJsonSchema({**DATE_TIME, "maxLength": 40})] | None


@dataclass(frozen=True, slots=True)
class Span:
    """A span from ``start`` up to ``end``, µs since the epoch."""

    start: int
    end: int


HistoryOf = Annotated[History, service(History)]


def moment(text: str, name: str) -> int:
    """Parse an ISO 8601 time with zone as µs since the epoch. A ``+`` that was not escaped, and so arrives as
    a blank, is understood. Raise Problem 422."""
    try:
        at = datetime.fromisoformat(_PLUS_LOST.sub(r"\1+\2", text.strip()))
    except ValueError:
        at = None
    if at is None or at.tzinfo is None:
        wrong = Message.of("time_malformed", field=name, example="2026-11-21T03:12:00Z", text=text)
        raise Problem(422, "invalid", wrong)
    refuse_year(at, name)
    return (at - _EPOCH) // _MICROSECOND


async def wanted_span(
    since: Annotated[MaybeMomentText, Query(alias="from")] = None,
    until: Annotated[MaybeMomentText, Query(alias="to")] = None,
) -> Span:
    """Return the requested span, by default the last hour."""
    end = micros(unix_now()) if until is None else moment(until, "to")
    start = end - HOUR if since is None else moment(since, "from")
    if start >= end:
        raise Problem(422, "invalid", Message("span_reversed"))
    return Span(start, end)


SpanOf = Annotated[Span, Depends(wanted_span)]


async def wanted_points(points: int = 1000) -> int:
    if not 1 <= points <= MAX_POINTS:
        raise Problem(422, "invalid", Message.of("points_out_of_range", most=MAX_POINTS))
    return points


PointsOf = Annotated[int, Depends(wanted_points)]


def series_query(history: History, bus: str, unit: int, value: str, span: Span, most: int) -> SeriesQuery:
    """Return the query of one value of one unit. Raise Problem 404 for an unknown bus or unit, 422 for an
    unknown value."""
    settings = history.buses.get(bus)
    if settings is None:
        raise unknown_bus(bus, history.buses)
    if all(known.id != unit for known in settings.unit):
        raise unknown_unit(bus, unit)
    if value not in VALUES:
        raise Problem(422, "invalid", Message.of("no_such_value", value=value, known=", ".join(VALUES)))
    if VALUES[value].kind == "draw" and unit not in settings.seams:
        raise Problem(422, "invalid", Message.of("no_draw_of_first", unit=unit))
    return SeriesQuery(settings, unit, VALUES[value], span.start, span.end, most)


def named_series_query(history: History, name: str, span: Span, most: int) -> SeriesQuery:
    """Return the query of one value named ``bus/unit/value``. Raise Problem."""
    bus, _, rest = name.partition("/")
    unit, _, value = rest.partition("/")
    number = parse_integer(unit)
    if number is None:
        raise Problem(422, "invalid", Message.of("series_malformed", example="dry-end/1/actual", text=name))
    return series_query(history, bus, number, value, span, most)


def series_queries(history: History, names: list[str], span: Span, most: int) -> list[SeriesQuery]:
    """Return the queries of several values, each named ``bus/unit/value``. Raise Problem."""
    if not 1 <= len(names) <= MAX_SERIES:
        raise Problem(422, "invalid", Message.of("series_count", most=MAX_SERIES, count=len(names)))
    return [named_series_query(history, name, span, most) for name in names]


Column = Annotated[list[float | None], Field(description="In display units; null: a gap.")]
TimeList = Annotated[
    list[Instant | float], Field(description="ISO 8601 in UTC, or with format=epoch seconds since 1970.")
]

HistorySeries = TypedDict(
    "HistorySeries",
    {
        "bus": str,
        "unit": Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")],
        "value": Annotated[str, Field(description="Its name, such as actual or output.1.")],
        "measure": Annotated[str, Field(description="Unit of measurement; empty: none is configured.")],
        "decimals": Annotated[int | None, Field(description="Of the newest point; null: not known.")],
        "from": Annotated[Instant, Field(description="Start of the span, ISO 8601 in UTC.")],
        "to": Annotated[Instant, Field(description="End of the span, ISO 8601 in UTC.")],
        "resolution": Resolution,
        "bucket_s": Annotated[float, Field(description="Seconds that a point stands for; 0: one reading.")],
        "t": TimeList,
        "min": Column,
        "max": Column,
        "avg": Column,
    },
)


class Sparkline(TypedDict):
    """The columns of a sparkline."""

    t: TimeList
    avg: Column


class HistoryMarkText(TypedDict, total=False):
    """The texts of a mark in the reader's language."""

    what: str
    old: str
    new: str


class HistoryMark(TypedDict):
    """An event to be drawn into a chart."""

    t: Annotated[
        Instant | float, Field(description="ISO 8601 in UTC, or with format=epoch seconds since 1970.")
    ]
    until: Annotated[
        Instant | float | None,
        Field(description="Of readings that came late, which are those from t on: their end; else null."),
    ]
    id: Annotated[int, Field(description="Number of the event.")]
    kind: str
    what: str
    who: str
    bus: str | None
    unit: Annotated[int | None, Field(description="Address of the unit (#17), 1 to 255.")]
    old: str | None
    new: str | None
    outcome: str | None
    messages: Annotated[
        dict[str, MessageShown],
        Field(description="what, old and new as data, by field; empty: older."),
    ]
    shown: HistoryMarkText


class HistoryMarks(TypedDict):
    """The events of a span, oldest first."""

    marks: list[HistoryMark]
    more: Annotated[bool, Field(description="Whether there are more than the newest 500.")]


def json_of(model: Any) -> dict[int | str, dict[str, Any]]:
    """Return the ``responses=`` of an endpoint that writes its JSON itself."""
    return {200: {"model": model, "description": "Successful Response"}, **problems(404)}


EXPORT: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {
            "text/csv": {"schema": {"type": "string"}},
            "application/vnd.apache.parquet": {"schema": {"type": "string", "format": "binary"}},
        }
    },
    **problems(404, 501),
}
"""The description of the response with an export."""


MAX_MARKS = 500
MARK_KINDS = frozenset({"command", "mode", "estop", "run", "unit", "bus", "worker", "server", "clock"})
"""The kinds of events that explain a curve; sign-ins do not."""
LATE = ("event_history_follows", "event_readings_late")
"""The codes of events about late readings, whose message has the span of the readings."""
_TEXTS = ("what", "old", "new")
"""The fields of a mark that may be messages."""
_OF_MARK = ("id", "kind", "who", "bus", "unit", "outcome", *_TEXTS)


class Mark(NamedTuple):
    """An event and its place in a chart; ``until``: the end of a span, None for a moment."""

    at: UnixTime
    until: UnixTime | None
    event: Event


async def marks_of(
    events: EventLog, start: UnixTime, end: UnixTime, units: Sequence[str] | None
) -> tuple[list[Mark], bool]:
    """Return the marks of a span, oldest first, and whether there were more events. ``units``: only events of
    the site and of these, each ``bus/unit``; empty: of all. Raise StoreError."""
    found, after = await events.page(Filter(since=start, until=end), MAX_MARKS)
    marks = [Mark(event["time"], None, event) for event in found if _explains(event, units)]
    for code in LATE:
        # Readings may come long after their time.
        late, _ = await events.page(Filter(since=start, code=code), MAX_MARKS)
        spans = (Mark(_time(event, "since"), _time(event, "until"), event) for event in late)
        marks += [mark for mark in spans if mark.at < end and start <= (mark.until or mark.at)]
    return sorted(marks, key=attrgetter("at")), after is not None


def shown_mark(mark: Mark, times: str, language: Language) -> dict[str, Any]:
    """Return a mark in the form of the API; ``times``: iso or epoch."""
    event = mark.event
    messages = {name: event["messages"][name] for name in _TEXTS if name in event["messages"]}
    texts = {name: event[name] for name in _TEXTS if event[name]}
    return {
        **{name: event[name] for name in _OF_MARK},
        "t": time_shown(mark.at, times),
        "until": None if mark.until is None else time_shown(mark.until, times),
        "messages": {name: message_shown(message) for name, message in messages.items()},
        "shown": texts | {name: language.t(messages[name]) for name in messages.keys() & texts},
    }


def time_shown(at: UnixTime, times: str) -> str | UnixTime:
    """Return a time as ISO 8601 or, with ``times`` epoch, in seconds."""
    return at if times == "epoch" else iso(at)


def _explains(event: Event, units: Sequence[str] | None) -> bool:
    is_of_chosen = event["unit"] is None or not units or f"{event['bus']}/{event['unit']}" in units
    return event["kind"] in MARK_KINDS and is_of_chosen and not _is_late(event)


def _is_late(event: Event) -> bool:
    return "what" in event["messages"] and event["messages"]["what"].code in LATE


def _time(event: Event, name: str) -> UnixTime:
    return UnixTime(datetime.fromisoformat(str(event["messages"]["what"].params[name])).timestamp())


router = APIRouter(prefix="/api/v1/history", tags=["history"], route_class=ApiRoute)
SPARK_POINTS = 120
MAX_SPARKS = 255
TimeFormat = Annotated[Literal["iso", "epoch"], Query(alias="format")]


def shown(requested: SeriesQuery, found: QueryResult, times: str) -> dict[str, Any]:
    """Return a result in the form of the API."""
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
    """Return one value of one unit over a span, in at most ``points`` (1 to 20 000, else 1000) points.
    Columns ``t``, ``min``, ``max``, ``avg`` in display units, with the decimals (#3) and the analog scale
    (#22, #23) as they were known at that time. Every reading itself (``bucket_s`` 0) if that fits; of equal
    consecutive readings the first and the last. A null between is a hole. ``format=epoch`` gives times in
    seconds since the epoch."""
    requested = series_query(history, bus, unit, value, span, points)
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
    """Return several values at once, each named ``bus/unit/value`` (1 to 32): a list of results of GET
    /history."""
    requested = series_queries(history, series, span, points)
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
    """Return the sparklines of many units (up to 255): for each ``bus/unit/value`` the columns ``t`` and
    ``avg``, about 120 points."""
    if len(series) > MAX_SPARKS:
        raise Problem(422, "invalid", Message.of("too_many_sparklines", most=MAX_SPARKS, count=len(series)))
    requested = [named_series_query(history, name, span, SPARK_POINTS) for name in series]
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
    """List the events of a span, oldest first: events (setpoint changes too) of the site and of each
    ``bus/unit`` named, and the spans of readings that came late. At most the newest 500; ``more``: there were
    more. ``shown``: ``what``, ``old`` and ``new`` in the reader's language."""
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
    """Export any span as CSV or Parquet, streamed: ``series`` may be repeated, each ``bus/unit/value``. A
    draw is a column of a table; in rows of readings it is the two speeds that it is made of.

    ``resolution`` auto: readings if they are stored for the complete span, else minutes. ``layout=table``, of
    CSV: one row a time (a second, or longer over a long span) with every value in force then, in local time,
    under the names of units in the reader's language; ``form=reader``: also with the separator and the
    decimal sign of that language.
    """
    requested = series_queries(history, series, Span(span.start, span.end), 1)
    if layout == "table" and form.language is None:
        form = CsvForm(templates_of(request).language_of(request), ZoneInfo(history.time_zone))
    return await export_response(history, requested, file, resolution, form, layout)

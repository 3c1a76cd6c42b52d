"""The parameters of a request for history: values, span, number of points."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Annotated

from fastapi import Depends, Query
from pydantic import Field, WithJsonSchema

from app.core.web.request_rules import refuse_year
from app.core.web.services import service, unknown_bus, unknown_unit
from app.core.web.shape import DATE_TIME, parse_integer
from app.errors import Problem
from app.line.history.query import SeriesQuery
from app.line.history.series.runs import HOUR, micros
from app.line.history.series.values import VALUES
from app.line.history.service import History
from bus.instants import unix_now
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
    a blank, is understood. Raises Problem 422."""
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
    """Return the query of one value of one unit. Raises Problem 404 for an unknown bus or unit, 422 for an
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
    """Return the query of one value named ``bus/unit/value``. Raises Problem."""
    bus, _, rest = name.partition("/")
    unit, _, value = rest.partition("/")
    number = parse_integer(unit)
    if number is None:
        raise Problem(422, "invalid", Message.of("series_malformed", example="dry-end/1/actual", text=name))
    return series_query(history, bus, number, value, span, most)


def series_queries(history: History, names: list[str], span: Span, most: int) -> list[SeriesQuery]:
    """Return the queries of several values, each named ``bus/unit/value``. Raises Problem."""
    if not 1 <= len(names) <= MAX_SERIES:
        raise Problem(422, "invalid", Message.of("series_count", most=MAX_SERIES, count=len(names)))
    return [named_series_query(history, name, span, most) for name in names]

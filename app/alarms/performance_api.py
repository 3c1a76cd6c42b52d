"""The figures of the alarm system over HTTP: JSON and CSV."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from pydantic import AwareDatetime, Field
from starlette.responses import Response
from typing_extensions import TypedDict

from app.alarms.api import Alarms
from app.alarms.performance import FrequentAlarm, Performance, measure
from app.alarms.rules.performance import DAY_S, AlarmFigure
from app.audit.api import CSV
from app.errors import Problem
from app.web.access import Viewer
from app.web.api_route import ApiRoute
from app.web.shape import Instant, iso
from bus.instants import UnixTime, unix_now
from bus.messages import Message

router = APIRouter(prefix="/api/v1/alarms", tags=["alarms"], route_class=ApiRoute)

MAX_DAYS = 31
USUAL_DAYS = 7
COLUMNS = ("code", "value", "at_most", "at_least", "met", "from", "to", "observed_s")


ObservedShown = TypedDict(
    "ObservedShown",
    {
        "from": Annotated[Instant, Field(description="Where alarms were observed only later: then.")],
        "to": Instant,
        "observed_s": Annotated[float, Field(description="How long alarms were observed in this time.")],
    },
)


class AlarmPerformance(ObservedShown):
    """The figures of a time, and in how much of it alarms were observed."""

    figures: list[AlarmFigure]
    most_frequent: list[FrequentAlarm]


def month_at_most(since: datetime | None, until: datetime | None) -> tuple[UnixTime, UnixTime]:
    """From ``since`` to ``until``; the last week by default. Raises Problem 422."""
    end = unix_now() if until is None else UnixTime(until.timestamp())
    start = end - USUAL_DAYS * DAY_S if since is None else UnixTime(since.timestamp())
    if start >= end:
        raise Problem(422, "invalid", Message("span_reversed"))
    if end - start > MAX_DAYS * DAY_S:
        raise Problem(422, "invalid", Message.of("alarm_span_too_long", days=MAX_DAYS))
    return start, end


async def wanted_performance(
    alarms: Alarms,
    since: Annotated[AwareDatetime | None, Query(alias="from")] = None,
    until: Annotated[AwareDatetime | None, Query(alias="to")] = None,
) -> Performance:
    """The figures of a span."""
    return await measure(alarms, *month_at_most(since, until))


WantedPerformance = Annotated[Performance, Depends(wanted_performance)]


@router.get("/performance")
async def get_alarm_performance(_: Viewer, performance: WantedPerformance) -> AlarmPerformance:
    """The figures of ISA-18.2, clause 16, each against its target."""
    return {
        **_observed(performance),
        "figures": performance.figures,
        "most_frequent": performance.most_frequent,
    }


@router.get("/performance.csv", response_class=Response, responses=CSV)
async def get_alarm_performance_csv(_: Viewer, performance: WantedPerformance) -> Response:
    """The same figures, a row for each."""
    text = io.StringIO()
    rows = csv.DictWriter(text, COLUMNS)
    rows.writeheader()
    observed = _observed(performance)
    rows.writerows({**asdict(figure), **observed} for figure in performance.figures)
    name = {"Content-Disposition": 'attachment; filename="alarm-performance.csv"'}
    return Response(text.getvalue(), media_type="text/csv", headers=name)


def _observed(performance: Performance) -> ObservedShown:
    return {
        "from": iso(performance.start),
        "to": iso(performance.end),
        "observed_s": round(performance.observed_s, 3),
    }

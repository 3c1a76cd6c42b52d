"""The figures of the alarm system over HTTP: JSON and CSV."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from starlette.responses import Response

from app.alarms.api import Alarms
from app.alarms.journal.performance import AlarmPerformance, measure
from app.alarms.rules.performance import DAY_S
from app.audit.api import CSV
from app.errors import Problem
from app.web.admission.access import Viewer
from app.web.admission.bounds import refuse_year
from app.web.api.route import ApiRoute
from app.web.api.shape import ZonedTime, iso
from bus.instants import UnixTime, unix_now
from bus.messages import Message

router = APIRouter(prefix="/api/v1/alarms", tags=["alarms"], route_class=ApiRoute)

MAX_DAYS = 31
USUAL_DAYS = 7
COLUMNS = ("code", "value", "at_most", "at_least", "met", "from", "to", "observed_s")


def month_at_most(since: datetime | None, until: datetime | None) -> tuple[UnixTime, UnixTime]:
    """From ``since`` to ``until``; the last week by default. Raises Problem 422."""
    for name, at in (("from", since), ("to", until)):
        if at is not None:
            refuse_year(at, name)
    end = unix_now() if until is None else UnixTime(until.timestamp())
    start = end - USUAL_DAYS * DAY_S if since is None else UnixTime(since.timestamp())
    if start >= end:
        raise Problem(422, "invalid", Message("span_reversed"))
    if end - start > MAX_DAYS * DAY_S:
        raise Problem(422, "invalid", Message.of("alarm_span_too_long", days=MAX_DAYS))
    return start, end


async def wanted_performance(
    alarms: Alarms,
    since: Annotated[ZonedTime | None, Query(alias="from")] = None,
    until: Annotated[ZonedTime | None, Query(alias="to")] = None,
) -> AlarmPerformance:
    """The figures of a span."""
    return await measure(alarms, *month_at_most(since, until))


WantedPerformance = Annotated[AlarmPerformance, Depends(wanted_performance)]


@router.get("/performance")
async def get_alarm_performance(_: Viewer, performance: WantedPerformance) -> AlarmPerformance:
    """The figures of ISA-18.2, clause 16, each against its target."""
    return performance


@router.get("/performance.csv", response_class=Response, responses=CSV)
async def get_alarm_performance_csv(_: Viewer, performance: WantedPerformance) -> Response:
    """The same figures, a row for each."""
    text = io.StringIO()
    rows = csv.DictWriter(text, COLUMNS)
    rows.writeheader()
    span = {"from": iso(performance.start), "to": iso(performance.end), "observed_s": performance.observed_s}
    rows.writerows({**asdict(figure), **span} for figure in performance.figures)
    name = {"Content-Disposition": 'attachment; filename="alarm-performance.csv"'}
    return Response(text.getvalue(), media_type="text/csv", headers=name)

"""The figures of the alarm system over HTTP: JSON and CSV."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from starlette.responses import Response

from app.alarms.api import Alarms
from app.alarms.journal.performance import AlarmPerformance, measure
from app.alarms.rules.performance import DAY_S
from app.errors import Problem
from app.web.admission.access import Viewer
from app.web.admission.bounds import refuse_year
from app.web.api.route import ApiRoute
from app.web.api.shape import ZonedTime
from app.web.rendering.csv_file import CSV, Column, WantedCsv
from bus.instants import UnixTime, unix_now
from bus.messages import Message, term

router = APIRouter(prefix="/api/v1/alarms", tags=["alarms"], route_class=ApiRoute)

MAX_DAYS = 31
USUAL_DAYS = 7
COLUMNS = (
    *(Column("code", term("Figure")), Column("value", term("Value")), Column("at_most", term("At most"))),
    *(Column("at_least", term("At least")), Column("met", term("Target met"))),
    *(Column("from", term("From"), is_time=True), Column("to", term("To"), is_time=True)),
    Column("observed_s", term("Observed (s)")),
)


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
async def get_alarm_performance_csv(_: Viewer, performance: WantedPerformance, form: WantedCsv) -> Response:
    """The same figures, a row for each."""
    start, end = (datetime.fromtimestamp(float(at), UTC) for at in (performance.start, performance.end))
    rows = (
        (
            *(figure.code if form.language is None else Message(f"alarm_figure_{figure.code}"), figure.value),
            *(figure.at_most, figure.at_least, figure.met, start, end, performance.observed_s),
        )
        for figure in performance.figures
    )
    name = {"Content-Disposition": 'attachment; filename="alarm-performance.csv"'}
    return Response(form.head(COLUMNS) + form.rows(COLUMNS, rows), media_type="text/csv", headers=name)

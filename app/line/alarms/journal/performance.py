"""Measures the alarm system from its journal over a span of time, and serves the figures as JSON and CSV."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from pydantic import Field
from starlette.responses import Response

from app.core.database import StoreConnection
from app.core.web.admission.access import Viewer
from app.core.web.admission.bounds import refuse_year
from app.core.web.api.route import ApiRoute
from app.core.web.api.shape import InstantObject, ZonedTime
from app.core.web.rendering.csv_file import CSV, Column, WantedCsv
from app.errors import Problem
from app.line.alarms.api import Alarms
from app.line.alarms.journal.store import NamedAlarm
from app.line.alarms.monitor.line_alarms import LineAlarms
from app.line.alarms.rules.performance import (
    CHATTERS_S,
    DAY_S,
    FLEETING_S,
    STALE_S,
    WINDOW_S,
    AlarmCounts,
    AlarmFigure,
    FigureCode,
    ObservedSpan,
    figures,
    observed_within,
)
from app.line.alarms.rules.state_machine import AlarmFacts
from bus.instants import UnixTime, unix_now
from bus.messages import Message, term

MAX_FREQUENT = 10
_ANNUNCIATED = "after = 'unack_active' AND before <> 'unack_active'"
_IN_SPAN = f"{_ANNUNCIATED} AND at >= :start AND at < :end"
_OBSERVED = "SELECT starts, ends FROM alarm_observed WHERE ends > :start AND starts < :end"
_WINDOW = f"CAST(at / {WINDOW_S} AS INTEGER)"
_WINDOWS = f"SELECT {_WINDOW}, COUNT(*) FROM alarm_journal WHERE {_IN_SPAN} GROUP BY 1"
_PRIORITIES = f"SELECT priority, COUNT(*) FROM alarm_journal WHERE {_IN_SPAN} GROUP BY 1"
_FREQUENT = (
    "SELECT alarm, max(code), max(name), max(bus), max(unit), COUNT(*) AS times FROM alarm_journal"
    f" WHERE {_IN_SPAN} GROUP BY alarm ORDER BY times DESC, alarm LIMIT {MAX_FREQUENT}"
)
# Entries are in order by their ids. The time between two is not known where the clock was set back meanwhile.
_CHATTERING = (
    "SELECT COUNT(DISTINCT alarm) FROM (SELECT alarm, at, LAG(at) OVER former AS second,"
    f" LAG(at, 2) OVER former AS first FROM alarm_journal WHERE {_IN_SPAN}"
    " WINDOW former AS (PARTITION BY alarm ORDER BY id)) AS rises"
    f" WHERE first <= second AND second <= at AND at - first <= {CHATTERS_S}"
)
_FLEETING = (
    f"SELECT COUNT(*) FROM alarm_journal AS risen WHERE {_IN_SPAN} AND trigger = 'rise'"
    f" AND (SELECT trigger = 'clear' AND at BETWEEN risen.at AND risen.at + {FLEETING_S}"
    " FROM alarm_journal INDEXED BY alarm_journal_by_alarm"
    " WHERE alarm = risen.alarm AND id > risen.id ORDER BY id LIMIT 1)"
)
_ACKNOWLEDGED = (
    "SELECT at - (SELECT at FROM alarm_journal INDEXED BY alarm_journal_by_alarm WHERE alarm = seen.alarm"
    f" AND id < seen.id AND {_ANNUNCIATED} ORDER BY id DESC LIMIT 1) AS after_s"
    " FROM alarm_journal AS seen WHERE trigger = 'acknowledge' AND at >= :start AND at < :end"
)
_MEDIAN = (
    f"SELECT AVG(after_s) FROM (SELECT after_s, ROW_NUMBER() OVER (ORDER BY after_s) AS place,"
    f" COUNT(*) OVER () AS every FROM ({_ACKNOWLEDGED}) AS seen WHERE after_s >= 0) AS ordered"
    " WHERE place IN ((every + 1) / 2, (every + 2) / 2)"
)


@dataclass(frozen=True, slots=True)
class FrequentAlarm(NamedAlarm):
    """One of the ten most frequent alarms."""

    times: Annotated[int, Field(description="How often it was annunciated.")]


@dataclass(frozen=True, slots=True)
class AlarmPerformance:
    """The figures of a time, and in how much of it alarms were observed."""

    start: Annotated[
        InstantObject,
        Field(serialization_alias="from", description="Where alarms were observed only later: then."),
    ]
    end: Annotated[InstantObject, Field(serialization_alias="to")]
    observed_s: Annotated[float, Field(description="How long alarms were observed in this time.")]
    figures: list[AlarmFigure]
    most_frequent: list[FrequentAlarm]

    @property
    def is_observed(self) -> bool:
        """Whether enough of the time was observed for figures."""
        return self.observed_s >= WINDOW_S

    def covers(self, span_s: float) -> bool:
        """Whether all of a time so long was observed, but for a restart."""
        return span_s - self.observed_s < WINDOW_S


async def measure(alarms: LineAlarms, start: UnixTime, end: UnixTime) -> AlarmPerformance:
    """The figures of a span. Memory is bounded by its windows of ten minutes, time as any costly read is."""
    now, observed = _present(alarms.present_facts(), end), alarms.observed()
    return await alarms.store.read_costly(lambda connection: _measured(connection, start, end, observed, now))


def _measured(
    connection: StoreConnection,
    start: UnixTime,
    end: UnixTime,
    present: list[ObservedSpan],
    now: dict[FigureCode, int],
) -> AlarmPerformance:
    span = {"start": start, "end": end}
    stored = (ObservedSpan(*row) for row in connection.execute(_OBSERVED, span))
    observed = observed_within((*stored, *present), start, end)
    observed_s = sum(each.end - each.start for each in observed)

    def value(query: str) -> float | None:
        found: float | None = connection.execute(query, span).fetchone()[0]
        return found

    frequent = [FrequentAlarm(*row) for row in connection.execute(_FREQUENT, span)]
    measured = AlarmCounts(
        observed_s=observed_s,
        in_windows=dict(tuple(row) for row in connection.execute(_WINDOWS, span)),
        top_ten=sum(each.times for each in frequent),
        of_priority=dict(tuple(row) for row in connection.execute(_PRIORITIES, span)),
        chattering=int(value(_CHATTERING) or 0),
        fleeting=int(value(_FLEETING) or 0),
        acknowledge_median_s=value(_MEDIAN),
        now=now,
    )
    begins = observed[0].start if observed else start
    return AlarmPerformance(begins, end, round(observed_s, 3), figures(measured), frequent)


def _present(present: list[AlarmFacts], now: UnixTime) -> dict[FigureCode, int]:
    """The states at present, whatever the span."""
    states = Counter(facts.state for facts in present)
    risen = [facts.came for facts in present if facts.active and not facts.is_hidden]
    return {
        "stale": sum(at is not None and now - at > STALE_S for at in risen),
        "standing": len(risen),
        "shelved": states["shelved"],
        "suppressed": states["suppressed"],
        "out_of_service": states["out_of_service"],
    }


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
    """Return the span from ``since`` to ``until``, by default the last week. Raises Problem 422 for one that
    is reversed or too long."""
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

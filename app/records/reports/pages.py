"""The page of reports: a line or a unit, a span, and what happened."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.access import Viewer
from app.core.web.routes import SEARCH, GuardedRoute
from app.core.web.shape import iso
from app.core.web.templating import render
from app.errors import Problem
from app.line.alarms.api import Alarms
from app.records.handover.pages import places_of
from app.records.handover.rules.shifts import EVERYTHING, Shift
from app.records.reports.api import ReportsOf
from app.records.reports.rules import SpanName
from app.records.reports.service import Reports, shown
from bus.instants import UnixTime
from bus.messages import Message, term
from bus.validation import OneLine

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

SPANS: dict[SpanName, Message] = {
    "shift": term("This shift"),
    "last_shift": term("Shift before"),
    "today": term("Today"),
    "yesterday": term("Yesterday"),
    "week": term("Last 7 days"),
}
_FILES = {"html": "report.html", "units": "units.csv", "stops": "stops.csv"}


@router.get("/reports", dependencies=[SEARCH])
async def report_page(
    request: Request,
    _: Viewer,
    reports: ReportsOf,
    alarms: Alarms,
    place: Annotated[OneLine, Query(max_length=100)] = "",
    span: Annotated[OneLine, Query(max_length=20)] = "",
    since: Annotated[OneLine, Query(max_length=40)] = "",
    until: Annotated[OneLine, Query(max_length=40)] = "",
) -> Response:
    """Show the report that the address names, without a span that of the present shift; or why it fails."""
    report, fault, scope = None, None, EVERYTHING
    name = next((name for name in SPANS if name == span), None)
    wanted = reports.named(name or "shift")
    try:
        if name is None and (since or until):
            wanted = reports.span(since, until)
        scope = reports.scope_of(place)
        report = await reports.report(wanted, scope)
    except Problem as problem:
        fault = problem
    chosen = name or ("" if since or until else "shift")
    return render(
        request,
        "reports/page.html",
        status=200 if fault is None else fault.status,
        **({"report": None} if report is None else shown(report)),
        fault=None if fault is None else fault.message,
        scope=scope,
        place=place,
        places=places_of(alarms),
        place_of=alarms.place,
        spans=[(name, text, _address(place, span=name), name == chosen) for name, text in SPANS.items()],
        since=since if not chosen else _local(reports, wanted.start),
        until=until if not chosen else _local(reports, wanted.end),
        files=_files(wanted, place),
    )


def _address(place: str, **more: str) -> str:
    return "/reports?" + urlencode({**({"place": place} if place else {}), **more})


def _local(reports: Reports, at: UnixTime) -> str:
    """Format a moment for a field of date and time, by the clock of the site."""
    return datetime.fromtimestamp(float(at), reports.zone).strftime("%Y-%m-%dT%H:%M")


def _files(span: Shift, place: str) -> dict[str, str]:
    """Return the addresses of the files of a report."""
    bus, _, unit = place.partition("/")
    named = {name: value for name, value in (("bus", bus), ("unit", unit)) if value}
    query = urlencode({"from": iso(span.start), "to": iso(span.end), **named})
    return {kind: f"/api/v1/report/{name}?{query}" for kind, name in _FILES.items()}

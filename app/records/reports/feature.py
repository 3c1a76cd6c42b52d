"""The feature of reports of a line or unit over any span: on a page, over HTTP as JSON, CSV and one HTML
file, and by mail."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from functools import partial
from typing import Annotated, Any, NamedTuple
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Query
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from app.core.database import Database
from app.core.find.finders import Finders, FixedPlace
from app.core.web.access import Viewer
from app.core.web.api import ApiRoute
from app.core.web.assets import Assets
from app.core.web.csv_file import CSV, WantedCsv
from app.core.web.routes import DOWNLOAD, SEARCH, GuardedRoute
from app.core.web.services import service
from app.core.web.shape import attachment, iso, json_response
from app.core.web.templating import Templates, formats_of, render
from app.errors import Problem, StoreError
from app.feature import Feature, Services
from app.line.alarms.api import Alarms
from app.line.alarms.line_alarms import LineAlarms
from app.line.history.api import SpanOf
from app.line.history.service import seconds
from app.records.handover.api import HTML
from app.records.handover.figures import SpanFigures
from app.records.handover.rules import EVERYTHING, Scope, Shift
from app.records.handover.service import APART
from app.records.notification.outbox import ReportAttachments
from app.records.notification.service import Notification
from app.records.reports.report import SpanReport
from app.records.reports.rules import SpanName
from app.records.reports.service import (
    SHOWN_STOPS,
    ReportDocuments,
    Reports,
    ReportSchedule,
    file_name,
    shown,
    stops_text,
    units_text,
)
from bus.messages import Message, term
from bus.validation import OneLine

api_router = APIRouter(prefix="/api/v1/report", tags=["reports"], route_class=ApiRoute)

ReportsOf = Annotated[Reports, service(Reports)]
DocumentsOf = Annotated[ReportDocuments, service(ReportDocuments)]


class WantedReport(NamedTuple):
    """The span and the scope of a requested report."""

    span: Shift
    scope: Scope


async def _wanted_report(
    reports: ReportsOf,
    span: SpanOf,
    bus: Annotated[OneLine | None, Query(max_length=80, description="Without it, all.")] = None,
    unit: Annotated[int | None, Query(ge=1, le=255, description="Needs bus.")] = None,
) -> WantedReport:
    wanted = Shift(seconds(span.start), seconds(span.end))
    return WantedReport(wanted, reports.scope(bus, unit))


ReportOfQuery = Annotated[WantedReport, Depends(_wanted_report)]


@api_router.get("", response_model=SpanReport, dependencies=[SEARCH])
async def get_report(_: Viewer, reports: ReportsOf, wanted: ReportOfQuery) -> Response:
    """Report the activity of units in a span of at most 92 days: run time, time at speed, stops with duration
    and cause, speed, length, draw; also alarms, commands, drift, notes, and time without readings."""
    report = await reports.report(wanted.span, wanted.scope)
    return await json_response(lambda: report)


@api_router.get("/units.csv", response_class=Response, responses=CSV, dependencies=[DOWNLOAD])
async def get_report_units(_: Viewer, reports: ReportsOf, wanted: ReportOfQuery, form: WantedCsv) -> Response:
    """Return the units of a report as CSV, one in each row."""
    report = await reports.report(wanted.span, wanted.scope)
    return _csv(units_text(report, form), f"{file_name(report, wanted.scope)}-units.csv")


@api_router.get("/stops.csv", response_class=Response, responses=CSV, dependencies=[DOWNLOAD])
async def get_report_stops(_: Viewer, reports: ReportsOf, wanted: ReportOfQuery, form: WantedCsv) -> Response:
    """Return the stops of a report as CSV, one in each row: unit, began, ended, seconds, reason."""
    report = await reports.report(wanted.span, wanted.scope)
    return _csv(stops_text(report, form), f"{file_name(report, wanted.scope)}-stops.csv")


@api_router.get("/report.html", response_class=Response, responses=HTML, dependencies=[DOWNLOAD])
async def get_report_document(
    _: Viewer, reports: ReportsOf, documents: DocumentsOf, wanted: ReportOfQuery
) -> Response:
    """Return a report as one HTML file that needs no server, in the language of the site."""
    report = await reports.report(wanted.span, wanted.scope, SHOWN_STOPS)
    headers = APART | attachment(f"{file_name(report, wanted.scope)}.html")
    text = documents.document(report, wanted.scope)
    return Response(text, media_type="text/html; charset=utf-8", headers=headers)


def _csv(text: str, name: str) -> Response:
    return Response(text, media_type="text/csv; charset=utf-8", headers=attachment(name))


router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

SPANS: dict[SpanName, Message] = {
    "shift": term("This shift"),
    "last_shift": term("Shift before"),
    "today": term("Today"),
    "yesterday": term("Yesterday"),
    "week": term("Last 7 days"),
}
_PLACE = b"<!-- report -->"
"""The mark at which a page gets its report."""
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
    """Show the report that the address names (without a span: of the present shift), or why it fails. What
    stands before the report is sent before it is read."""
    fault, scope = None, EVERYTHING
    formats = formats_of(request)
    name = next((name for name in SPANS if name == span), None)
    wanted = reports.named(name or "shift")
    try:
        if name is None and (since or until):
            wanted = reports.span(formats.typed_time(since), formats.typed_time(until))
        scope = reports.scope_of(place)
        reports.refuse(wanted, scope)
    except Problem as problem:
        fault = problem
    chosen = name or ("" if since or until else "shift")
    page = render(
        request,
        "reports/page.html",
        status=200 if fault is None else fault.status,
        start=wanted.start,
        fault=None if fault is None else fault.message,
        place=place,
        places=alarms.places(),
        spans=[(name, text, _address(place, span=name), name == chosen) for name, text in SPANS.items()],
        since=formats.field_minute(wanted.start) if chosen or fault is None else since,
        until=formats.field_minute(wanted.end) if chosen or fault is None else until,
    )
    if fault is not None:
        return page
    read = partial(reports.report, wanted, scope, SHOWN_STOPS)
    parts = _with_report(
        request, bytes(page.body), read, scope=scope, place_of=alarms.place, files=_files(wanted, place)
    )
    return StreamingResponse(parts, headers={"Cache-Control": "no-store"}, media_type="text/html")


async def _with_report(
    request: Request, page: bytes, read: Callable[[], Awaitable[Mapping[str, Any]]], **context: Any
) -> AsyncIterator[bytes]:
    """Yield a page up to the place of the report, then the report or why it cannot be read, and the rest."""
    before, _, after = page.partition(_PLACE)
    yield before
    try:
        part = render(request, "reports/_shown.html", fault=None, **shown(await read()), **context)
    except (Problem, StoreError) as error:
        part = render(request, "reports/_shown.html", fault=error.message)
    yield bytes(part.body)
    yield after


def _address(place: str, **more: str) -> str:
    return "/reports?" + urlencode({**({"place": place} if place else {}), **more})


def _files(span: Shift, place: str) -> dict[str, str]:
    """Return the addresses of the files of a report."""
    bus, _, unit = place.partition("/")
    named = {name: value for name, value in (("bus", bus), ("unit", unit)) if value}
    query = urlencode({"from": iso(span.start), "to": iso(span.end), **named})
    return {kind: f"/api/v1/report/{name}?{query}" for kind, name in _FILES.items()}


def make(services: Services) -> None:
    settings, database = services.settings, services[Database]
    reports = services.add(Reports(settings, database, services[SpanFigures]))
    templates, assets = services[Templates], services[Assets]
    documents = services.add(ReportDocuments(reports, templates, assets, services[LineAlarms]))
    services.add(ReportAttachments(documents.attachment))
    services[Finders].add_links("find_actions", [FixedPlace(Message("find_report"), "/reports")])
    if settings.report:
        # Notification is made later: it needs the attachments.
        schedule = ReportSchedule(settings, lambda items: services[Notification].dispatcher.add(items))
        services.lifespan.add("reports", schedule.follow)


FEATURE = Feature(make, (api_router, router))

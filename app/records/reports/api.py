"""Reports of any span over HTTP: as JSON, as CSV, and as one HTML file."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from fastapi import APIRouter, Depends, Query
from starlette.responses import Response

from app.core.web.access import Viewer
from app.core.web.api import ApiRoute
from app.core.web.csv_file import CSV, WantedCsv
from app.core.web.routes import DOWNLOAD, SEARCH
from app.core.web.services import service
from app.core.web.shape import json_response
from app.line.history.service import seconds
from app.line.history.spans import SpanOf
from app.records.handover.api import HTML
from app.records.handover.rules.shifts import Scope, Shift
from app.records.handover.service import APART
from app.records.reports.report import SpanReport
from app.records.reports.service import ReportDocuments, Reports, file_name, stops_text, units_text
from bus.validation import OneLine

router = APIRouter(prefix="/api/v1/report", tags=["reports"], route_class=ApiRoute)

ReportsOf = Annotated[Reports, service(Reports)]
DocumentsOf = Annotated[ReportDocuments, service(ReportDocuments)]


class WantedReport(NamedTuple):
    """The span and the places of a requested report."""

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


@router.get("", response_model=SpanReport, dependencies=[SEARCH])
async def get_report(_: Viewer, reports: ReportsOf, wanted: ReportOfQuery) -> Response:
    """Report what the units did in a span of at most 92 days: run time, time at speed, stops with duration
    and cause, speed, length, draw; alarms, commands, drift and notes. Time without readings is apart."""
    report = await reports.report(wanted.span, wanted.scope)
    return await json_response(lambda: report)


@router.get("/units.csv", response_class=Response, responses=CSV, dependencies=[DOWNLOAD])
async def get_report_units(_: Viewer, reports: ReportsOf, wanted: ReportOfQuery, form: WantedCsv) -> Response:
    """Return the units of a report, one in a row."""
    report = await reports.report(wanted.span, wanted.scope)
    return _csv(units_text(report, form), f"{file_name(report, wanted.scope)}-units.csv")


@router.get("/stops.csv", response_class=Response, responses=CSV, dependencies=[DOWNLOAD])
async def get_report_stops(_: Viewer, reports: ReportsOf, wanted: ReportOfQuery, form: WantedCsv) -> Response:
    """Return the stops of a report, one in a row: unit, began, ended, seconds, reason."""
    report = await reports.report(wanted.span, wanted.scope)
    return _csv(stops_text(report, form), f"{file_name(report, wanted.scope)}-stops.csv")


@router.get("/report.html", response_class=Response, responses=HTML, dependencies=[DOWNLOAD])
async def get_report_document(
    _: Viewer, reports: ReportsOf, documents: DocumentsOf, wanted: ReportOfQuery
) -> Response:
    """Return a report as one HTML file that needs no server, in the language of the site."""
    report = await reports.report(wanted.span, wanted.scope)
    headers = APART | _attachment(f"{file_name(report, wanted.scope)}.html")
    text = documents.document(report, wanted.scope)
    return Response(text, media_type="text/html; charset=utf-8", headers=headers)


def _csv(text: str, name: str) -> Response:
    return Response(text, media_type="text/csv; charset=utf-8", headers=_attachment(name))


def _attachment(name: str) -> dict[str, str]:
    return {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-store"}

"""A report for templates, as one HTML file that needs no server, and as CSV. An unknown figure is empty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from app.core.web.assets import Assets
from app.core.web.csv_file import Cell, Column, CsvForm
from app.core.web.formats import lasting
from app.core.web.templating import Templates
from app.line.alarms.line_alarms import LineAlarms
from app.records.handover.document import readable
from app.records.handover.rules.shifts import Scope, Shift
from app.records.notification.outbox import Attachment, ReportNotice
from app.records.reports.service import Reports
from bus.instants import UnixTime
from bus.messages import Message, term

_PLACE = (Column("bus", term("Bus")), Column("unit", term("Unit")), Column("name", term("Name")))
_SPAN = (Column("start", term("From"), is_time=True), Column("end", term("To"), is_time=True))
_FIGURES = (
    *(Column("known_s", term("With readings (s)")), Column("running_s", term("Ran (s)"))),
    *(Column("length", term("Length")), Column("length_unit", term("Unit of length"))),
)
_STOPPED = (Column("stops", term("Stops")), Column("stopped_s", term("Stopped (s)")))
_MORE = (
    *(Column("at_speed_s", term("At speed (s)")), Column("unread_s", term("No readings (s)"))),
    *(Column("speed_average", term("Average speed")), Column("speed_greatest", term("Greatest speed"))),
    Column("speed_unit", term("Unit of speed")),
)
_DRAW = (
    *(Column("draw_average", term("Draw")), Column("draw_least", term("Least draw"))),
    Column("draw_greatest", term("Greatest draw")),
)
_COUNTS = (
    *(Column("alarms", term("Alarms")), Column("commands", term("Commands"))),
    Column("by_minute", term("From averages of minutes")),
)
_UNIT_COLUMNS = (*_PLACE, *_SPAN, *_FIGURES, *_STOPPED, *_MORE, *_DRAW, *_COUNTS)
_STOP_COLUMNS = (
    *_PLACE,
    *(Column("began", term("Began"), is_time=True), Column("ended", term("Ended"), is_time=True)),
    *(Column("seconds", term("Duration (s)")), Column("reason", term("Cause"))),
)


def units_text(report: Mapping[str, Any], form: CsvForm) -> str:
    """Write the CSV file with one unit in a row."""
    return form.head(_UNIT_COLUMNS) + form.rows(_UNIT_COLUMNS, _unit_rows(report))


def stops_text(report: Mapping[str, Any], form: CsvForm) -> str:
    """Write the CSV file with one stop in a row, unit by unit."""
    return form.head(_STOP_COLUMNS) + form.rows(_STOP_COLUMNS, _stop_rows(report, form))


def _unit_rows(report: Mapping[str, Any]) -> Iterator[tuple[Cell, ...]]:
    for unit in report["units"]:
        stops = [stop["seconds"] for stop in unit["stops"]] if "stops" in unit else None
        stopped = (None, None) if stops is None else (len(stops), round(sum(stops), 3))
        draw = unit["draw"] or {}
        yield (
            *_place(unit),
            *(_at(report["start"]), _at(report["until"])),
            *(unit.get(column.name) for column in _FIGURES),
            *stopped,
            *(unit.get(column.name) for column in _MORE),
            *(draw.get(column.name.removeprefix("draw_")) for column in _DRAW),
            *(unit.get(column.name) for column in _COUNTS),
        )


def _stop_rows(report: Mapping[str, Any], form: CsvForm) -> Iterator[tuple[Cell, ...]]:
    for unit in report["units"]:
        for stop in unit.get("stops", ()):
            cause = stop["cause"] if form.language is None else Message(f"report_stop_{stop['cause']}")
            yield (*_place(unit), _at(stop["start"]), _at(stop["end"]), stop["seconds"], cause)


def _place(unit: Mapping[str, Any]) -> tuple[Cell, ...]:
    return unit["bus"], unit["unit"], unit["name"]


def _at(text: str) -> datetime:
    return datetime.fromisoformat(text)


STYLE = "css/report-document.css"


class ReportDocuments:
    """Renders reports as files, without a request."""

    def __init__(self, reports: Reports, templates: Templates, assets: Assets, alarms: LineAlarms) -> None:
        self._reports = reports
        self._templates = templates
        self._assets = assets
        self._alarms = alarms

    def document(self, report: Mapping[str, Any], scope: Scope) -> str:
        """Render a report as an HTML file."""
        return self._templates.text(
            self._templates.site.language,
            "reports/document.html",
            **shown(report),
            scope=scope,
            place_of=self._alarms.place,
            style=self._assets.get(STYLE).body.decode(),
        )

    async def attachment(self, notice: ReportNotice) -> Attachment:
        """Make the attachment of a mail. Raises Problem for a unit that is gone, and StoreError."""
        scope = self._reports.scope(notice.bus, notice.unit)
        report = await self._reports.report(Shift(UnixTime(notice.start), UnixTime(notice.end)), scope)
        return Attachment(f"{file_name(report, scope)}.html", self.document(report, scope), summary(report))


def shown(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return the variables of templates: the report with the cause of each stop as a message, its summary."""
    found = readable(report)
    for unit in found["units"]:
        for stop in unit.get("stops", ()):
            stop["reason"] = Message(f"report_stop_{stop['cause']}")
    return {"report": found, "summary": summary(report), "is_read": _is_read(report)}


def summary(report: Mapping[str, Any]) -> tuple[Message, ...]:
    """Summarize a report in a few words."""
    stops = [stop["seconds"] for unit in report["units"] for stop in unit.get("stops", ())]
    stopped = Message.of("report_stops", n=len(stops), lasting=lasting(sum(stops)))
    return (
        stopped if _is_read(report) else Message("report_no_readings"),
        Message.of("report_alarms", n=len(report["alarms"])),
        Message.of("report_drift", n=len(report["drift"])),
        Message.of("report_notes", n=len(report["notes"])),
    )


def _is_read(report: Mapping[str, Any]) -> bool:
    """Tell whether any unit was read; whether the others stopped is not known."""
    return any(unit.get("known_s") for unit in report["units"])


def file_name(report: Mapping[str, Any], scope: Scope) -> str:
    """Return the name of a file without its suffix: the place and the first minute, UTC."""
    place = "-".join(str(each) for each in scope if each is not None)
    start = str(report["start"])[:16].replace(":", "")
    return "-".join(part for part in ("report", place, f"{start}Z") if part)

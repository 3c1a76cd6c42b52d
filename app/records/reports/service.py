"""The service of reports of any span: makes them, renders them as one HTML file that needs no server and as
CSV, and puts those that are due for mail into the outbox. An unknown figure is empty."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Mapping
from datetime import datetime
from sys import maxsize
from typing import Any
from zoneinfo import ZoneInfo

import structlog

from app.core.database import Database, StoreConnection
from app.core.database.connection import snapshot
from app.core.web.assets import Assets
from app.core.web.csv_file import Cell, Column, CsvForm
from app.core.web.request_rules import refuse_year
from app.core.web.services import unknown_bus, unknown_unit
from app.core.web.shape import parse_integer
from app.core.web.templating import Templates
from app.errors import Problem, StoreError
from app.line.alarms.line_alarms import LineAlarms
from app.records.handover.figures import SpanFigures, line_summary
from app.records.handover.rules import EVERYTHING, Scope, Shift, site_time
from app.records.handover.service import readable
from app.records.notification.outbox import Attachment, OutboxItem, ReportNotice
from app.records.notification.rules import NotificationEndpoint
from app.records.reports.report import span_report
from app.records.reports.rules import SpanName, last_due, named_span, span_fault
from app.settings import Settings
from bus.instants import UnixTime, unix_now
from bus.messages import Message, term

CHECK_S = 20.0
Send = Callable[[list[OutboxItem]], Awaitable[None]]
log = structlog.get_logger()


class ReportSchedule:
    """The schedule that puts due reports into the outbox. The outbox takes each once for an address: a server
    that was off sends the report that it missed, and none twice."""

    def __init__(self, settings: Settings, send: Send) -> None:
        self._settings = settings
        self._send = send

    async def follow(self) -> None:
        """Send reports when they are due, until canceled."""
        while True:
            try:
                await self.send_due()
            except StoreError as error:
                log.error("reports wait", error=str(error))
            await asyncio.sleep(CHECK_S)

    async def send_due(self) -> None:
        """Put the reports that are due now into the outbox."""
        items = list(self._due(unix_now()))
        if items:
            await self._send(items)

    def _due(self, now: UnixTime) -> Iterator[OutboxItem]:
        starts, zone = self._settings.shift.minutes, ZoneInfo(self._settings.site.zone)
        for report in self._settings.report:
            span = last_due(report.every, report.minute, now, starts, zone)
            if span is None:
                continue
            start, end = site_time(span.start, zone), site_time(span.end, zone)
            scope = "/".join(str(each) for each in (report.bus, report.unit) if each is not None)
            notice = ReportNotice(
                every=report.every,
                start=float(span.start),
                end=float(span.end),
                first=start,
                last=end,
                place=f"{self._settings.site.name} {scope}".strip(),
                bus=report.bus,
                unit=report.unit,
            )
            key = f"report:{report.every}:{scope}:{float(span.start):.0f}"
            for address in report.to:
                yield OutboxItem(key, NotificationEndpoint("mail", address).key, "report", now, notice)


class Reports:
    """The service that reads a report from the stores of the running server."""

    def __init__(self, settings: Settings, database: Database, figures: SpanFigures) -> None:
        self.settings = settings
        self.zone = ZoneInfo(settings.site.zone)
        self._database = database
        self._figures = figures

    def named(self, name: SpanName) -> Shift:
        """Return the span of a name, as of now."""
        return named_span(name, unix_now(), self.settings.shift.minutes, self.zone)

    def span(self, since: str, until: str) -> Shift:
        """Parse the ends of a span in fields of a page; empty ``until`` is now. Raise Problem 422."""
        return Shift(self._moment(since, "from"), self._moment(until, "to") if until else unix_now())

    def scope(self, bus: str | None, unit: int | None) -> Scope:
        """Return the scope of a configured bus or unit. Raise Problem 404, or 422 for a unit without bus."""
        if bus is None and unit is not None:
            raise Problem(422, "invalid", Message("report_unit_without_bus"))
        if bus is None:
            return EVERYTHING
        known = {each.name: {unit.id for unit in each.unit} for each in self.settings.bus}
        if bus not in known:
            raise unknown_bus(bus, known)
        if unit is not None and unit not in known[bus]:
            raise unknown_unit(bus, unit)
        return Scope(bus, unit)

    def scope_of(self, place: str) -> Scope:
        """Parse a scope such as ``dry-end`` or ``dry-end/4``; empty is the site. Raise Problem 404."""
        bus, slash, address = place.partition("/")
        unit = parse_integer(address, 3) if slash else None
        if slash and unit is None:
            raise Problem(404, "unknown_unit", Message.of("report_unknown_place", place=place))
        return self.scope(bus or None, unit)

    async def report(self, span: Shift, scope: Scope, most_stops: int = maxsize) -> dict[str, Any]:
        """Return the report of a span, up to now if it is under way, with at most ``most_stops`` of each
        unit, the newest. Raise Problem 422 or StoreError."""
        self.refuse(span, scope)
        now = unix_now()
        found = await self._figures.units(span, scope, now)

        def read(connection: StoreConnection) -> dict[str, Any]:
            with snapshot(connection):
                return span_report(connection, self.settings, span, now, scope, found, most_stops)

        return await self._database.read_costly(read)

    def refuse(self, span: Shift, scope: Scope) -> None:
        """Raise Problem 422 if a span has no report."""
        fault = span_fault(span, unix_now(), self._count(scope))
        if fault is not None:
            raise Problem(422, "invalid", fault)

    def _count(self, scope: Scope) -> int:
        """Count the units of a scope, at least one."""
        places = ((bus.name, unit.id) for bus in self.settings.bus for unit in bus.unit)
        return max(1, sum(scope.holds(*place) for place in places))

    def _moment(self, text: str, name: str) -> UnixTime:
        try:
            written = datetime.fromisoformat(text.strip())
            refuse_year(written, name)
            return UnixTime((written if written.tzinfo else written.replace(tzinfo=self.zone)).timestamp())
        except (ValueError, OverflowError):
            wrong = Message.of("typed_time_malformed", example="2026-11-21 06:00", text=text)
            raise Problem(422, "invalid", wrong) from None


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
    *(Column("before", term("Stood before")), Column("goes_on", term("Goes on"))),
)


def units_text(report: Mapping[str, Any], form: CsvForm) -> str:
    """Write the CSV file with one unit in a row."""
    return form.head(_UNIT_COLUMNS) + form.rows(_UNIT_COLUMNS, _unit_rows(report))


def stops_text(report: Mapping[str, Any], form: CsvForm) -> str:
    """Write the CSV file with one stop in a row, unit by unit."""
    return form.head(_STOP_COLUMNS) + form.rows(_STOP_COLUMNS, _stop_rows(report, form))


def _unit_rows(report: Mapping[str, Any]) -> Iterator[tuple[Cell, ...]]:
    for unit in report["units"]:
        draw = unit["draw"] or {}
        yield (
            *_place(unit),
            *(_at(report["start"]), _at(report["until"])),
            *(unit.get(column.name) for column in _FIGURES),
            *(unit.get("stop_count"), unit.get("stopped_s")),
            *(unit.get(column.name) for column in _MORE),
            *(draw.get(column.name.removeprefix("draw_")) for column in _DRAW),
            *(unit.get(column.name) for column in _COUNTS),
        )


def _stop_rows(report: Mapping[str, Any], form: CsvForm) -> Iterator[tuple[Cell, ...]]:
    for unit in report["units"]:
        for stop in unit.get("stops", ()):
            cause = stop["cause"] if form.language is None else Message(f"report_stop_{stop['cause']}")
            yield (
                *_place(unit),
                _at(stop["start"]),
                _at(stop["end"]),
                stop["seconds"],
                cause,
                stop["before"],
                stop["goes_on"],
            )


def _place(unit: Mapping[str, Any]) -> tuple[Cell, ...]:
    return unit["bus"], unit["unit"], unit["name"]


def _at(text: str) -> datetime:
    return datetime.fromisoformat(text)


STYLE = "css/pages/report-document.css"
SHOWN_STOPS = 200
"""The most stops that a page or an HTML file shows, the newest; the CSV has all."""


class ReportDocuments:
    """The renderer of reports as files; it needs no request."""

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
        """Return the attachment of a mail. Raise Problem for a unit that is gone, and StoreError."""
        scope = self._reports.scope(notice.bus, notice.unit)
        span = Shift(UnixTime(notice.start), UnixTime(notice.end))
        report = await self._reports.report(span, scope, SHOWN_STOPS)
        return Attachment(f"{file_name(report, scope)}.html", self.document(report, scope), summary(report))


def shown(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return the variables of templates: the report, the newest stops of all units with their causes as
    messages, the summary."""
    rows = [(unit, stop) for unit in report["units"] for stop in unit.get("stops", ())]
    newest = sorted(rows, key=lambda row: row[1]["start"])[-SHOWN_STOPS:]
    return {
        "report": readable({**report, "units": [{**unit, "stops": []} for unit in report["units"]]}),
        "stops": [
            (unit, {**readable(stop), "reason": Message(f"report_stop_{stop['cause']}")})
            for unit, stop in newest
        ],
        "stop_count": sum(unit.get("stop_count", 0) for unit in report["units"]),
        "summary": summary(report),
        "is_read": _is_read(report),
    }


def summary(report: Mapping[str, Any]) -> tuple[Message, ...]:
    """Return a summary of a report in a few words."""
    return (
        *line_summary(report["line"]),
        Message.of("report_drift", n=len(report["drift"])),
        Message.of("report_notes", n=len(report["notes"])),
    )


def _is_read(report: Mapping[str, Any]) -> bool:
    """Return whether any unit was read; without readings stops are not known."""
    return any(unit.get("known_s") for unit in report["units"])


def file_name(report: Mapping[str, Any], scope: Scope) -> str:
    """Return the name of a file without its suffix: the place and the first minute, UTC."""
    place = "-".join(str(each) for each in scope if each is not None)
    start = str(report["start"])[:16].replace(":", "")
    return "-".join(part for part in ("report", place, f"{start}Z") if part)

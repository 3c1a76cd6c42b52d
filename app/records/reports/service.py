"""Makes reports of any span, and puts those that are due into the outbox of notification to be mailed."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from datetime import datetime
from typing import Any
from zoneinfo import ZoneInfo

import structlog

from app.core.database import Database, StoreConnection
from app.core.database.connection import snapshot
from app.core.web.request_rules import refuse_year
from app.core.web.services import unknown_bus, unknown_unit
from app.core.web.shape import parse_integer
from app.errors import Problem, StoreError
from app.line.history.service import History
from app.line.history.unit_report import UnitReport
from app.records.handover.rules.shifts import EVERYTHING, Scope, Shift, site_time
from app.records.notification.outbox import OutboxItem, ReportNotice
from app.records.notification.plan import NotificationEndpoint
from app.records.reports.report import reported_buses, span_report
from app.records.reports.rules import SpanName, last_due, named_span, span_fault
from app.settings import Settings
from bus.instants import UnixTime, unix_now
from bus.messages import Message
from bus.settings import BusSettings

CHECK_S = 20.0
Send = Callable[[list[OutboxItem]], Awaitable[None]]
log = structlog.get_logger()


class ReportSchedule:
    """Puts reports that are due into the outbox. That takes each once for an address: a server that was off
    sends the report that it missed, and none twice."""

    def __init__(self, settings: Settings, send: Send) -> None:
        self._settings = settings
        self._send = send

    async def follow(self) -> None:
        """Send reports when they are due, indefinitely."""
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
    """Reads a report from the stores of the running server."""

    def __init__(self, settings: Settings, database: Database, history: History) -> None:
        self.settings = settings
        self.zone = ZoneInfo(settings.site.zone)
        self._database = database
        self._history = history

    def named(self, name: SpanName) -> Shift:
        """Return the span of a name, as of now."""
        return named_span(name, unix_now(), self.settings.shift.minutes, self.zone)

    def span(self, since: str, until: str) -> Shift:
        """Parse the ends of a span in fields of a page; empty ``until`` is now. Raises Problem 422."""
        return Shift(self._moment(since, "from"), self._moment(until, "to") if until else unix_now())

    def scope(self, bus: str | None, unit: int | None) -> Scope:
        """Return the scope of a configured bus or unit. Raises Problem 404, 422 for a unit without bus."""
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
        """Parse a scope, such as ``dry-end`` or ``dry-end/4``; empty is the site. Raises Problem 404."""
        bus, slash, address = place.partition("/")
        unit = parse_integer(address, 3) if slash else None
        if slash and unit is None:
            raise Problem(404, "unknown_unit", Message.of("report_unknown_place", place=place))
        return self.scope(bus or None, unit)

    async def report(self, span: Shift, scope: Scope) -> dict[str, Any]:
        """Make the report of a span, up to now if it is under way. Raises Problem 422, and StoreError."""
        now = unix_now()
        fault = span_fault(span, now, self._count(scope))
        if fault is not None:
            raise Problem(422, "invalid", fault)
        found = await self._figures(span, scope, now)

        def read(connection: StoreConnection) -> dict[str, Any]:
            with snapshot(connection):
                return span_report(connection, self.settings, span, now, scope, found)

        return await self._database.read_costly(read)

    async def _figures(
        self, span: Shift, scope: Scope, now: UnixTime
    ) -> list[tuple[BusSettings, UnitReport]]:
        """Read what each unit did, one by one, so that other reads come in between."""
        found = []
        for bus, figures in reported_buses(self.settings, scope, span, now):
            for unit in figures.units:
                read = await self._history.read(
                    lambda connection, tail, figures=figures, unit=unit: figures.read(connection, tail, unit),  # type: ignore[misc]
                    costly=True,
                )
                if read is not None:
                    found.append((bus, read))
        return found

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
            wrong = Message.of("time_malformed", field=name, example="2026-11-21T06:00", text=text)
            raise Problem(422, "invalid", wrong) from None

"""Puts the reports that are due into the outbox of notification, from which they are sent by mail."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from zoneinfo import ZoneInfo

import structlog

from app.errors import StoreError
from app.records.handover.rules.shift_times import site_time
from app.records.notification.notice import OutboxItem, ReportNotice
from app.records.notification.sending.endpoints import NotificationEndpoint
from app.records.reports.rules.spans import last_due
from app.settings import Settings
from bus.instants import Clock, UnixTime, unix_now

CHECK_S = 20.0
Send = Callable[[list[OutboxItem]], Awaitable[None]]
log = structlog.get_logger()


class ReportSchedule:
    """The outbox takes each report once for each of its addresses: a server that was off sends the report
    that it missed, and none twice."""

    def __init__(self, settings: Settings, send: Send, clock: Clock = unix_now) -> None:
        self._settings = settings
        self._send = send
        self._clock = clock

    async def follow(self) -> None:
        """Look for due reports, without end."""
        while True:
            try:
                await self.look()
            except StoreError as error:
                log.error("reports wait", error=str(error))
            await asyncio.sleep(CHECK_S)

    async def look(self) -> None:
        """Put the reports that are due now into the outbox."""
        items = list(self._due(self._clock()))
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

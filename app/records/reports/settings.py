"""The settings of reports that are mailed on a schedule: ``[[report]]`` of lineside.toml."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from pydantic import Field

from app.records.notification.settings import ClockTime, MailAddress, NotifySettings, minute_of_day
from app.records.reports.rules import ReportEvery
from bus.messages import Message
from bus.settings import BusSettings, StrictModel
from bus.validation import setting_fault


class ReportSettings(StrictModel):
    """A report that people get after each shift, day or week."""

    every: ReportEvery
    at: ClockTime = "06:00"
    """The local time at which a daily report is sent, and on Mondays a weekly report; a shift's report is
    sent five minutes after its end."""
    bus: str | None = None
    """None: all buses."""
    unit: Annotated[int, Field(strict=True, ge=1, le=255)] | None = None
    """None: all units of the bus."""
    to: Annotated[tuple[MailAddress, ...], Field(min_length=1, max_length=50)]

    @property
    def minute(self) -> int:
        """``at`` as minutes after midnight."""
        return minute_of_day(self.at)


def refuse_unsendable(
    reports: Iterable[ReportSettings], notify: NotifySettings, buses: Iterable[BusSettings]
) -> None:
    """Raise PydanticCustomError for a report of a bus or unit that is not configured, or if there is no mail
    server."""
    units = {bus.name: {unit.id for unit in bus.unit} for bus in buses}
    for index, report in enumerate(reports):
        if report.bus is not None and report.bus not in units:
            raise setting_fault(Message.of("setting_notify_bus", bus=report.bus), "report", index, "bus")
        if report.unit is not None and report.unit not in units.get(report.bus or "", ()):
            raise setting_fault(Message.of("setting_report_unit", unit=report.unit), "report", index, "unit")
        if notify.smtp is None:
            raise setting_fault(Message("setting_mail_server_missing"), "report", index, "to")

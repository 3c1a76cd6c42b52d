"""Rules of reports: the span of each kind, and the time at which a scheduled report is due; the settings of
``[[report]]`` in lineside.toml. Pure.

A day is from midnight to midnight by the clock of the site, a week from Monday to Monday.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime, timedelta
from typing import Annotated, Literal
from zoneinfo import ZoneInfo

from pydantic import Field

from app.records.handover.rules import Shift, shift_at
from app.records.notification.settings import ClockTime, MailAddress, NotifySettings, minute_of_day
from bus.instants import DAY_S, UnixTime
from bus.messages import Message
from bus.settings import BusSettings, StrictModel
from bus.validation import setting_fault

SpanName = Literal["shift", "last_shift", "today", "yesterday", "week"]
ReportEvery = Literal["shift", "day", "week"]
MAX_DAYS = 92
MAX_UNIT_DAYS = 1800
"""The most units times days: all 255 units of a bus for a week."""
SETTLE_S = 300.0
"""The seconds after a shift's end at which its report is sent: late readings are stored by then."""
LATE_S = 43_200.0
"""The delay after which a due report is not sent: the server was off or the schedule is new."""
_MIDNIGHT = (0,)


def named_span(name: SpanName, now: UnixTime, starts: Sequence[int], zone: ZoneInfo) -> Shift:
    """Return the span of a name; ``week``: today and the six days before."""
    if name in ("shift", "last_shift"):
        present = shift_at(now, starts, zone)
        return present if name == "shift" else shift_at(present.start - 1.0, starts, zone)
    today = _day(now, zone)
    if name == "yesterday":
        return _day(today.start - 1.0, zone)
    return today if name == "today" else Shift(_days_before(now, 6, zone), today.end)


def span_fault(span: Shift, now: UnixTime, units: int) -> Message | None:
    """Return the reason why a span with so many units gets no report; None if it gets one."""
    days = (min(span.end, now) - span.start) / DAY_S
    if not UnixTime(0.0) < span.start < min(span.end, now):
        return Message("report_span_malformed")
    if days > MAX_DAYS:
        return Message.of("report_span_too_long", days=MAX_DAYS)
    if days * units > MAX_UNIT_DAYS:
        most = max(1, int(MAX_UNIT_DAYS / units))
        return Message.of("report_too_many_units", n=most, units=units, days=most)
    return None


def last_due(
    every: ReportEvery, minute: int, now: UnixTime, starts: Sequence[int], zone: ZoneInfo
) -> Shift | None:
    """Return the last complete span whose report is due; None if it was due too long ago.

    ``minute``: the minute of the day at which a daily report is sent, and on Mondays a weekly report.
    """
    if every == "shift":
        span = shift_at(shift_at(now - SETTLE_S, starts, zone).start - 1.0, starts, zone)
        due = span.end + SETTLE_S
    else:
        due = shift_at(now, (minute,), zone).start
        if every == "week":
            due = _at_minute(due, datetime.fromtimestamp(float(due), zone).weekday(), minute, zone)
        today = _day(due, zone).start
        span = Shift(_days_before(due, 1 if every == "day" else 7, zone), today)
    return span if now - due <= LATE_S else None


def _day(at: UnixTime, zone: ZoneInfo) -> Shift:
    return shift_at(at, _MIDNIGHT, zone)


def _days_before(at: UnixTime, days: int, zone: ZoneInfo) -> UnixTime:
    """Return the midnight ``days`` before that of a moment."""
    return _day(_at_minute(at, days, 12 * 60, zone), zone).start


def _at_minute(at: UnixTime, days: int, minute: int, zone: ZoneInfo) -> UnixTime:
    """Return the moment at which the clock shows a minute of the day, ``days`` before ``at``."""
    local = datetime.fromtimestamp(float(at), zone).replace(tzinfo=None) - timedelta(days=days)
    local = local.replace(hour=minute // 60, minute=minute % 60, second=0, microsecond=0)
    return UnixTime(local.replace(tzinfo=zone).timestamp())


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

"""A report as templates show it, and as one HTML file in the language of the site that needs no server."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.core.web.rendering.assets import Assets
from app.core.web.rendering.formats import lasting
from app.core.web.rendering.templating import Templates
from app.line.alarms.line_alarms import LineAlarms
from app.records.handover.rules.scope import Scope
from app.records.handover.rules.shift_times import Shift
from app.records.handover.sheet.document import readable
from app.records.notification.notice import Attachment, ReportNotice
from app.records.reports.service import Reports
from bus.instants import UnixTime
from bus.messages import Message

STYLE = "css/report-document.css"


class ReportDocuments:
    """Renders reports apart from any request."""

    def __init__(self, reports: Reports, templates: Templates, assets: Assets, alarms: LineAlarms) -> None:
        self._reports = reports
        self._templates = templates
        self._assets = assets
        self._alarms = alarms

    def document(self, report: Mapping[str, Any], scope: Scope) -> str:
        """A report as a file."""
        return self._templates.text(
            self._templates.site.language,
            "reports/document.html",
            **shown(report),
            scope=scope,
            place_of=self._alarms.place,
            style=self._assets.get(STYLE).body.decode(),
        )

    async def attachment(self, notice: ReportNotice) -> Attachment:
        """The report of a notice, as a mail has it. Raises Problem for a unit that is gone; StoreError."""
        scope = self._reports.scope(notice.bus, notice.unit)
        report = await self._reports.report(Shift(UnixTime(notice.start), UnixTime(notice.end)), scope)
        return Attachment(f"{file_name(report, scope)}.html", self.document(report, scope), summary(report))


def shown(report: Mapping[str, Any]) -> dict[str, Any]:
    """What templates show of a report: itself, with a message for the cause of each stop, and its summary."""
    found = readable(report)
    for unit in found["units"]:
        for stop in unit.get("stops", ()):
            stop["reason"] = Message(f"report_stop_{stop['cause']}")
    return {"report": found, "summary": summary(report), "is_read": _is_read(report)}


def summary(report: Mapping[str, Any]) -> tuple[Message, ...]:
    """The report in a few words."""
    stops = [stop["seconds"] for unit in report["units"] for stop in unit.get("stops", ())]
    stopped = Message.of("report_stops", n=len(stops), lasting=lasting(sum(stops)))
    return (
        stopped if _is_read(report) else Message("report_no_readings"),
        Message.of("report_alarms", n=len(report["alarms"])),
        Message.of("report_drift", n=len(report["drift"])),
        Message.of("report_notes", n=len(report["notes"])),
    )


def _is_read(report: Mapping[str, Any]) -> bool:
    """Whether any unit was read: of the others it is not known whether they stopped."""
    return any(unit.get("known_s") for unit in report["units"])


def file_name(report: Mapping[str, Any], scope: Scope) -> str:
    """Without its suffix: the place and the first minute, UTC."""
    place = "-".join(str(each) for each in scope if each is not None)
    start = str(report["start"])[:16].replace(":", "")
    return "-".join(part for part in ("report", place, f"{start}Z") if part)

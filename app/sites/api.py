"""``GET /sites``: every line in short."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import Field
from typing_extensions import TypedDict

from app.alarms.api import AlarmPriorityShown
from app.live.screen.fields import Translator
from app.messages import DEFAULT
from app.sites.board import LineOnBoard
from app.sites.fleet import FleetLookup
from app.sites.tile import no_report, shown_level, verdict_text
from app.web.admission.access import Viewer
from app.web.api.route import ApiRoute
from app.web.api.shape import Instant, MessageShown, iso, maybe_shown, message_shown
from app.web.rendering.templating import Templates
from app.web.services import service
from bus.instants import UnixTime, unix_now

router = APIRouter(prefix="/api/v1", tags=["line"], route_class=ApiRoute)
TemplatesService = Annotated[Templates, service(Templates)]
AlarmCount = Annotated[dict[str, int], Field(description="By priority; one without alarms is left out.")]


class LineAlarmsShown(TypedDict):
    """The alarms of a line in numbers, and the first of them."""

    active: AlarmCount
    unacknowledged: AlarmCount
    first: Annotated[MessageShown | None, Field(description="Its text; null: there is none.")]
    first_priority: AlarmPriorityShown | None


class LineOfSite(TypedDict):
    """One line. All but ``bus``, ``stale``, ``age_s`` and ``verdict`` is as it was reported last, null where
    it never was."""

    bus: str
    site: str | None
    stale: Annotated[bool, Field(description="It is no longer reported: its state is not known.")]
    age_s: Annotated[float | None, Field(description="Seconds since the report; null: there is none.")]
    level: Annotated[
        AlarmPriorityShown | None, Field(description="Of the verdict; null: nothing is abnormal.")
    ]
    verdict: MessageShown
    units: Annotated[int | None, Field(description="How many are configured.")]
    states: Annotated[
        dict[str, int] | None,
        Field(description="How many units are online, at_speed, ramping, at_zero, off_speed."),
    ]
    alarms: LineAlarmsShown | None
    scan_hz: Annotated[float | None, Field(description="Scans per second.")]
    speeds: Annotated[
        list[float | None] | None,
        Field(description="Of the first unit, in display units, a point each 10 s, the newest last."),
    ]


class LinesOfSites(TypedDict):
    """Every line, the worst first."""

    time: Instant
    lines: list[LineOfSite]


@router.get("/sites")
async def get_sites(
    _: Viewer, fleet: FleetLookup, templates: TemplatesService, site: str | None = None
) -> LinesOfSites:
    """Every line, the worst first. ``site``: only those of the site of this name."""
    english = Translator(templates.languages[DEFAULT], templates.formats(DEFAULT))
    now = unix_now()
    found = fleet.board.lines()
    lines = [line for line in found if site is None or (line.summary and line.summary.site == site)]
    return {"time": iso(now), "lines": [line_json(line, english, now) for line in lines]}


def line_json(line: LineOnBoard, english: Translator, now: UnixTime) -> LineOfSite:
    """A line for programs."""
    summary = line.summary
    head: dict[str, Any] = {
        "bus": line.bus,
        "stale": line.is_stale,
        "age_s": None if summary is None else round(line.age_s, 3),
        "level": shown_level(line) or None,
        "verdict": message_shown(no_report(line)),
    }
    if summary is None:
        names = ("site", "units", "states", "alarms", "scan_hz", "speeds")
        return {**dict.fromkeys(names), **head}  # type: ignore[typeddict-item]
    if not line.is_stale:
        head["verdict"] = _verdict(line, english, now)
    return {
        **head,  # type: ignore[typeddict-item]
        "site": summary.site,
        "units": summary.units,
        "states": summary.states,
        "alarms": {
            "active": {str(name): count for name, count in summary.active.items()},
            "unacknowledged": {str(name): count for name, count in summary.waiting.items()},
            "first": maybe_shown(summary.alarm),
            "first_priority": summary.alarm_priority or None,
        },
        "scan_hz": summary.scan_hz,
        "speeds": summary.speeds,
    }


def _verdict(line: LineOnBoard, english: Translator, now: UnixTime) -> MessageShown:
    summary = line.summary
    assert summary is not None
    if summary.cause is None:
        return message_shown(summary.verdict)
    cause = summary.cause
    params: dict[str, Any] = {"place": summary.place, "motion": cause.motion, "mode": cause.mode}
    given = {name: value for name, value in params.items() if value}
    return {"code": cause.code, "params": given, "detail": verdict_text(summary, english, now)}

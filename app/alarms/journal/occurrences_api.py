"""``GET /api/v1/alarms/occurrences``: what a chart marks."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import Field
from starlette.requests import Request
from typing_extensions import TypedDict

from app.alarms.alarm import BusName, UnitNumber
from app.alarms.api import Alarms
from app.alarms.journal.occurrences import MAX_OCCURRENCES, Occurrence, occurrences
from app.alarms.monitor.line_alarms import LineAlarms
from app.alarms.shown import AlarmPriorityShown
from app.history.service import seconds
from app.history.spans import SpanOf
from app.web.admission.access import Viewer
from app.web.admission.turns import SEARCH
from app.web.api.route import ApiRoute
from app.web.api.shape import Instant, MaybeInstant, iso
from app.web.rendering.templating import templates_of

router = APIRouter(prefix="/api/v1/alarms", tags=["alarms"], route_class=ApiRoute)

MAX_UNITS = 255


class AlarmOccurrenceText(TypedDict):
    """In the reader's language."""

    name: str
    place: str


AlarmOccurrence = TypedDict(
    "AlarmOccurrence",
    {
        "alarm": Annotated[str, Field(description="The id of the occurrence.")],
        "name": str,
        "code": str,
        "bus": BusName,
        "unit": UnitNumber,
        "priority": AlarmPriorityShown,
        "from": Annotated[Instant, Field(description="When it was annunciated, ISO 8601.")],
        "to": Annotated[MaybeInstant, Field(description="Until when it was active; null: it still is.")],
        "shown": AlarmOccurrenceText,
    },
)


class AlarmOccurrences(TypedDict):
    """Occurrences of a span, oldest first."""

    occurrences: list[AlarmOccurrence]
    more: Annotated[bool, Field(description="Whether there are more than the newest 500.")]


@router.get("/occurrences", dependencies=[SEARCH])
async def get_alarm_occurrences(
    request: Request,
    _: Viewer,
    alarms: Alarms,
    span: SpanOf,
    unit: Annotated[list[str] | None, Query(max_length=MAX_UNITS)] = None,
) -> AlarmOccurrences:
    """When alarms were annunciated and active in a span: those of each ``bus/unit`` named and of its bus, or
    all. At most the newest 500. What was hidden all the time is in the journal alone."""
    keys = _keys(alarms, unit or [])
    found = await occurrences(alarms.store, keys, seconds(span.start), seconds(span.end))
    language = templates_of(request).language_of(request)

    def shown(each: Occurrence) -> AlarmOccurrence:
        return {
            "alarm": f"{each.alarm}.{each.occurrence}",
            "name": each.name,
            "code": each.code,
            "bus": each.bus,
            "unit": each.unit,
            "priority": each.priority,
            "from": iso(each.start),
            "to": None if each.end is None else iso(each.end),
            "shown": {"name": language.t(each.shown_name), "place": alarms.place(each.bus, each.unit)},
        }

    newest = found[-MAX_OCCURRENCES:]
    return {"occurrences": [shown(each) for each in newest], "more": len(found) > len(newest)}


def _keys(alarms: LineAlarms, units: list[str]) -> list[str]:
    buses = {unit.rpartition("/")[0] for unit in units}

    def concerns(bus: str | None, unit: int | None) -> bool:
        return not units or (bus in buses if unit is None else f"{bus}/{unit}" in units)

    definitions = (alarm.definition for alarm in alarms.every())
    return [each.key for each in definitions if concerns(each.bus, each.unit)]

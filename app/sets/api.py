"""Parameter sets over HTTP: taken, listed, compared."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from app.audit.api import Events
from app.errors import Problem
from app.live.api.routes import Live
from app.live.lookup import bus_or_404, unit_or_404
from app.sets import view
from app.sets.acts import EXPORT_SECRET, MARK_GOLDEN, SAVE, SCHEDULE
from app.sets.compare import ParameterDifference, compare
from app.sets.document import write_document
from app.sets.drift import BusDrift
from app.sets.keeper import SetKeeper
from app.sets.lookup import Sets, StoredSet, set_or_404, unit_rows_or_404
from app.sets.model import ParameterSetSummary
from app.sets.schedule import SetSchedule
from app.web.access import Person, Viewer
from app.web.api_route import ApiRoute
from app.web.schema import problems
from app.web.services import bus_service, bus_service_of
from app.web.shape import StrictBody, UnitAddresses
from bus.messages import Message
from bus.text import Lines, OneLine

router = APIRouter(prefix="/api/v1", tags=["parameter sets"], route_class=ApiRoute)
MAX_SETS = 1000
"""Sets of one response."""
DOCUMENT: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/toml": {"schema": {"type": "string"}}}}
}


class SaveSetRequest(StrictBody):
    """Which units to read now (all of the bus when empty)."""

    units: Annotated[UnitAddresses, Field(default_factory=list)]
    name: Annotated[OneLine, Field(max_length=80)] = ""
    comment: Annotated[Lines, Field(max_length=1000)] = ""


class GoldenSetRequest(StrictBody):
    """The unit whose golden set this becomes."""

    unit: int


class SaveScheduleRequest(StrictBody):
    """Minute of the local day at which all units of the bus are read; null ends it."""

    minute_of_day: Annotated[int, Field(ge=0, le=1439)] | None


ParameterSets = Annotated[SetKeeper, bus_service(SetKeeper)]
Drift = Annotated[BusDrift, bus_service(BusDrift)]
ScheduleOfBus = Annotated[SetSchedule, bus_service(SetSchedule)]


@router.get("/sets")
async def list_parameter_sets(
    _: Viewer,
    sets: Sets,
    bus: str | None = None,
    unit: int | None = None,
    before: int | None = None,
    limit: Annotated[int, Query(ge=1, le=MAX_SETS)] = MAX_SETS,
) -> list[ParameterSetSummary]:
    """Stored sets, newest first: at most 1000; the last ``id`` is ``before`` of the next page."""
    return await sets.summaries(bus, unit, before=before, limit=limit)


@router.post("/buses/{bus}/sets", status_code=201, responses=problems(504))
async def save_parameter_set(
    person: Annotated[Person, SAVE.permitted],
    keeper: ParameterSets,
    live: Live,
    bus: str,
    wanted: SaveSetRequest,
) -> view.ParameterSetShown:
    """Read the units now and save the values; nothing is saved if a unit does not respond."""
    known = bus_or_404(live, bus).units
    units = wanted.units or list(known)
    for unit in units:
        unit_or_404(live, bus, unit)
    return view.set_json(await keeper.take(person, units, wanted.name, wanted.comment))


@router.get("/sets/{set_id}")
async def get_parameter_set(_: Viewer, stored: StoredSet) -> view.ParameterSetShown:
    """A set with the evidence of each value; #21 is masked."""
    return view.set_json(stored)


@router.get("/sets/{set_id}/document", response_class=Response, responses=DOCUMENT)
async def export_parameter_set(
    person: Viewer, stored: StoredSet, events: Events, secrets: bool = False
) -> Response:
    """The set as a TOML file. With ``secrets`` (engineer) it contains #21, and the export is an event."""
    if secrets:
        if not person.role.includes(EXPORT_SECRET.role):
            raise Problem(403, "forbidden", Message("secret_for_engineer"))
        await events.record(**EXPORT_SECRET.by(person, set=stored.id), bus=stored.bus)
    headers = {"Content-Disposition": f'attachment; filename="lineside-{stored.bus}-{stored.id}.toml"'}
    return Response(
        write_document(stored, with_secrets=secrets), media_type="application/toml", headers=headers
    )


@router.post("/sets/{set_id}/golden")
async def mark_golden_set(
    request: Request,
    person: Annotated[Person, MARK_GOLDEN.permitted],
    stored: StoredSet,
    mark: GoldenSetRequest,
) -> view.GoldenSet:
    """Make this set the golden set of the unit."""
    await bus_service_of(request, stored.bus, SetKeeper).mark_golden(person, stored, mark.unit)
    return {"set": stored.id, "unit": mark.unit, "golden": True}


@router.get("/sets/{set_id}/compare/{other_id}")
async def compare_parameter_sets(
    _: Viewer,
    sets: Sets,
    stored: StoredSet,
    other_id: int,
    unit: int,
    other_unit: int | None = None,
    tolerance: int = 0,
) -> list[ParameterDifference]:
    """Set with set, row by row."""
    left = unit_rows_or_404(stored, unit)
    right = unit_rows_or_404(await set_or_404(sets, other_id), other_unit or unit)
    return compare(left, right, tolerance)


@router.get("/buses/{bus}/units/{unit}/drift")
async def get_drift(_: Viewer, drift: Drift, live: Live, bus: str, unit: int) -> view.DriftShown:
    """Drift of the unit, as last read, from its golden set, and who changed it: ``changed_by`` null is a
    change at the panel. ``unread``: parameters that could not be compared yet."""
    unit_or_404(live, bus, unit)
    return {
        "golden": drift.has_golden(unit),
        "unread": drift.unread(unit),
        "rows": [view.departure_json(one) for one in await drift.traced(unit)],
    }


@router.get("/buses/{bus}/set-schedule")
async def get_save_schedule(_: Viewer, sets: Sets, schedule: ScheduleOfBus, bus: str) -> view.SaveSchedule:
    """Minute of the day at which the units of the bus are read, and overdue units with the reason."""
    overdue: list[view.OverdueSave] = [
        {"unit": unit, "why": each.why} for unit, each in schedule.overdue().items()
    ]
    return {"minute_of_day": (await sets.schedule()).get(bus), "overdue": overdue}


@router.put("/buses/{bus}/set-schedule")
async def set_save_schedule(
    person: Annotated[Person, SCHEDULE.permitted], schedule: ScheduleOfBus, wanted: SaveScheduleRequest
) -> view.SaveSchedule:
    """Read all units of the bus daily, or end the schedule."""
    await schedule.set(person, wanted.minute_of_day)
    return {"minute_of_day": wanted.minute_of_day, "overdue": []}

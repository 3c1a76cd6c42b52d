"""The HTTP API of parameter sets: save, list, compare; and its schemas. Only an export shows #21."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from typing_extensions import TypedDict

from app.core.web.access import Person, Viewer
from app.core.web.api import NEXT_PAGE, ApiRoute, link_next, problems
from app.core.web.services import bus_service, bus_service_of
from app.core.web.shape import MessageObject, StrictBody, UnitAddresses, attachment, iso
from app.engineering.sets.drift import BusDrift, DriftedParameter
from app.engineering.sets.lookup import Sets, StoredSet, set_or_404, unit_rows_or_404
from app.engineering.sets.model import (
    Number,
    ParameterDifference,
    ParameterSet,
    ParameterSetSummary,
    SetHead,
    StoredRaw,
    UnitRows,
    compare,
    with_unit,
)
from app.engineering.sets.saving import EXPORT_SECRET, MARK_GOLDEN, SAVE, SCHEDULE, SetKeeper, SetSchedule
from app.engineering.sets.store import write_document
from app.errors import Problem
from app.line.live.api.routes import Live
from app.line.live.api.view import MaybeTime, UnitAddress
from app.line.live.requests import bus_or_404, unit_or_404
from app.people.audit.api import Events
from bus.catalogue.parameters import PARAMETERS
from bus.messages import Message
from bus.validation import Lines, OneLine

router = APIRouter(prefix="/api/v1", tags=["parameter sets"], route_class=ApiRoute)
MAX_SETS = 1000
"""The most sets in one response."""
DOCUMENT: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/toml": {"schema": {"type": "string"}}}}
}


class SaveSetRequest(StrictBody):
    """The units to read now; all units of the bus if empty."""

    units: Annotated[UnitAddresses, Field(default_factory=list)]
    name: Annotated[OneLine, Field(max_length=80)] = ""
    comment: Annotated[Lines, Field(max_length=1000)] = ""


class GoldenSetRequest(StrictBody):
    """The unit for which this set becomes the golden set."""

    unit: int


class SaveScheduleRequest(StrictBody):
    """The minute of the local day at which all units of the bus are read; null: no schedule."""

    minute_of_day: Annotated[int, Field(ge=0, le=1439)] | None


class ParameterSetParameter(TypedDict):
    """A parameter in a set."""

    number: Number
    name: str
    raw: StoredRaw
    value: Annotated[str | None, Field(description="As shown to people; null: not known, or a secret.")]
    available: Annotated[bool, Field(description="Whether the unit has it.")]
    read_at: MaybeTime
    frame: Annotated[
        str | None, Field(description="The response with the value, hexadecimal; null: a secret.")
    ]


class ParameterSetUnit(TypedDict):
    """A unit in a set."""

    id: UnitAddress
    name: str
    parameters: list[ParameterSetParameter]


@dataclass(frozen=True, slots=True)
class ParameterSetShown(SetHead):
    """A stored parameter set with its values."""

    units: list[ParameterSetUnit]


class GoldenSet(TypedDict):
    """The golden set of a unit."""

    set: int
    unit: UnitAddress
    golden: bool


@dataclass(frozen=True, slots=True)
class DriftRow(ParameterDifference):
    """A difference of a unit from its golden set, with the author of the change."""

    changed_by: Annotated[str | None, Field(description="User or token; null: changed at the keypad.")]
    changed_at: MaybeTime
    changed: Annotated[MessageObject, Field(description="At the keypad, or by whom.")]


class DriftShown(TypedDict):
    """The differences of a unit, as last read, from its golden set."""

    golden: Annotated[bool, Field(description="Whether it has a golden set.")]
    unread: Annotated[int, Field(description="How many parameters could not be compared yet, 0 to 40.")]
    rows: list[DriftRow]


class OverdueSave(TypedDict):
    """A unit whose set of the day could not be saved yet."""

    unit: UnitAddress
    why: Annotated[MessageObject | None, Field(description="Why.")]


class SaveSchedule(TypedDict):
    """The daily schedule that saves the sets of a bus."""

    minute_of_day: Annotated[int | None, Field(description="Local time, 0 to 1439; null: not by schedule.")]
    overdue: list[OverdueSave]


ParameterSets = Annotated[SetKeeper, bus_service(SetKeeper)]
Drift = Annotated[BusDrift, bus_service(BusDrift)]
ScheduleOfBus = Annotated[SetSchedule, bus_service(SetSchedule)]


@router.get("/sets", responses=NEXT_PAGE)
async def list_parameter_sets(
    request: Request,
    response: Response,
    _: Viewer,
    sets: Sets,
    bus: str | None = None,
    unit: int | None = None,
    before: int | None = None,
    limit: Annotated[int, Query(ge=1, le=MAX_SETS)] = MAX_SETS,
) -> list[ParameterSetSummary]:
    """List stored sets, newest first, at most 1000. The header ``Link`` names the next page: its ``before``
    is the last ``id`` of this one."""
    found = await sets.summaries(bus, unit, before=before, limit=limit + 1)
    if len(found) > limit:
        link_next(request, response, found[limit - 1].id)
    return found[:limit]


@router.post("/buses/{bus}/sets", status_code=201, responses=problems(504))
async def save_parameter_set(
    person: Annotated[Person, SAVE.permitted],
    keeper: ParameterSets,
    live: Live,
    bus: str,
    wanted: SaveSetRequest,
) -> ParameterSetShown:
    """Read the units now and save the values; nothing is saved if a unit does not respond."""
    known = bus_or_404(live, bus).units
    units = wanted.units or list(known)
    for unit in units:
        unit_or_404(live, bus, unit)
    return _set_json(await keeper.read_and_save(person, units, wanted.name, wanted.comment))


@router.get("/sets/{set_id}")
async def get_parameter_set(_: Viewer, stored: StoredSet) -> ParameterSetShown:
    """Return a set with the frame that proves each value; #21 is masked."""
    return _set_json(stored)


@router.get("/sets/{set_id}/document", response_class=Response, responses=DOCUMENT)
async def export_parameter_set(
    person: Viewer, stored: StoredSet, events: Events, secrets: bool = False
) -> Response:
    """Export the set as a TOML file. ``secrets`` includes #21: for engineers only, and recorded."""
    if secrets:
        if not person.role.includes(EXPORT_SECRET.role):
            raise Problem(403, "forbidden", Message("secret_for_engineer"))
        await events.record(**EXPORT_SECRET.by(person, set=stored.id), bus=stored.bus)
    text, name = write_document(stored, with_secrets=secrets), f"lineside-{stored.bus}-{stored.id}.toml"
    return Response(text, media_type="application/toml", headers=attachment(name))


@router.post("/sets/{set_id}/golden")
async def mark_golden_set(
    request: Request,
    person: Annotated[Person, MARK_GOLDEN.permitted],
    stored: StoredSet,
    mark: GoldenSetRequest,
) -> GoldenSet:
    """Make this set the golden set of a unit."""
    await bus_service_of(request, stored.bus, SetKeeper).mark_golden(person, stored, [mark.unit])
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
    """Compare the units of two sets row by row."""
    left = unit_rows_or_404(stored, unit)
    right = unit_rows_or_404(await set_or_404(sets, other_id), other_unit or unit)
    return compare(left, right, tolerance)


@router.get("/buses/{bus}/units/{unit}/drift")
async def get_drift(_: Viewer, drift: Drift, live: Live, bus: str, unit: int) -> DriftShown:
    """Return the parameters in which the unit, as last read, differs from its golden set. ``changed_by``:
    null for a change at the keypad. ``unread``: parameters that could not be compared yet."""
    unit_or_404(live, bus, unit)
    return {
        "golden": drift.has_golden(unit),
        "unread": drift.unread(unit),
        "rows": [_departure_json(one) for one in await drift.traced(unit)],
    }


@router.get("/buses/{bus}/set-schedule")
async def get_save_schedule(_: Viewer, sets: Sets, schedule: ScheduleOfBus, bus: str) -> SaveSchedule:
    """Return the minute of the day at which the bus is saved, and the units that are overdue and why."""
    overdue: list[OverdueSave] = [
        {"unit": unit, "why": each.why} for unit, each in schedule.overdue().items()
    ]
    return {"minute_of_day": (await sets.schedule()).get(bus), "overdue": overdue}


@router.put("/buses/{bus}/set-schedule")
async def set_save_schedule(
    person: Annotated[Person, SCHEDULE.permitted], schedule: ScheduleOfBus, wanted: SaveScheduleRequest
) -> SaveSchedule:
    """Save all units of the bus daily, or end the schedule."""
    await schedule.set(person, wanted.minute_of_day)
    return {"minute_of_day": wanted.minute_of_day, "overdue": []}


def _set_json(stored: ParameterSet) -> ParameterSetShown:
    """Return a complete set as JSON; secrets are masked."""
    head: dict[str, Any] = {each.name: getattr(stored, each.name) for each in fields(SetHead)}
    return ParameterSetShown(**head, units=[_unit_json(rows) for rows in stored.units])


def _unit_json(rows: UnitRows) -> ParameterSetUnit:
    parameters: list[ParameterSetParameter] = []
    for number, row in sorted(rows.rows.items()):
        parameter = PARAMETERS[number]
        raw = None if parameter.secret else row.raw
        parameters.append(
            {
                "number": number,
                "name": parameter.name,
                "raw": raw,
                "value": None if raw is None else str(with_unit(parameter, raw, rows)),
                "available": row.available,
                "read_at": None if row.read_at is None else iso(row.read_at),
                "frame": None if parameter.secret else row.frame.hex(" "),
            }
        )
    return {"id": rows.unit, "name": rows.name, "parameters": parameters}


def _departure_json(departure: DriftedParameter) -> DriftRow:
    """Return a difference from the golden set as JSON, with its author."""
    change = departure.change
    row: dict[str, Any] = {each.name: getattr(departure.row, each.name) for each in fields(departure.row)}
    return DriftRow(
        **row,
        changed_by=None if change is None else change["who"],
        changed_at=None if change is None else iso(change["time"]),
        changed=Message("changed_at_panel")
        if change is None
        else Message.of("changed_by", who=change["who"]),
    )

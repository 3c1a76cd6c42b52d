"""Restores over HTTP: planned, started, followed."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from pydantic import Field

from app.core.web.admission.access import Person, Viewer
from app.core.web.admission.bounds import MAX_BODY_BYTES
from app.core.web.api.route import ApiRoute
from app.core.web.api.schema import problems
from app.core.web.api.shape import Numbers, StrictBody
from app.engineering.sets.acts import CANCEL, PLAN, START
from app.engineering.sets.lookup import KnownRestore, Restores, Sets, wanted_rows
from app.engineering.sets.restore.plan import Selection
from app.engineering.sets.restore.view import RestoreShown, restore_json
from app.line.live.api.routes import Live
from app.line.live.lookup import unit_or_404

router = APIRouter(prefix="/api/v1", tags=["parameter sets"], route_class=ApiRoute)

Planner = Annotated[Person, PLAN.permitted]
Included = Annotated[
    Numbers, Field(description="rows that are left out unless named: the setpoints #20 and #37")
]
Excluded = Annotated[Numbers, Field(description="rows not to write")]


class RestoreRequest(StrictBody):
    """The source of a restore: a stored set, or a TOML document with one unit (or with this one).
    ``ticked``: dangerous rows (#18, #19, #27) to write, each confirmed by its number."""

    set: int | None = None
    document: str | None = None
    from_unit: int | None = None
    include: Annotated[Included, Field(default_factory=list)]
    exclude: Annotated[Excluded, Field(default_factory=list)]
    ticked: Annotated[Numbers, Field(default_factory=list)]


class StartRestoreRequest(StrictBody):
    """Another choice of rows than the plan was made with; a member left out or null stays as planned."""

    include: Included | None = None
    exclude: Excluded | None = None


@router.post(
    "/buses/{bus}/units/{unit}/restores",
    status_code=201,
    responses=problems(504),
    max_body_size=MAX_BODY_BYTES,
)
async def plan_restore(
    person: Planner,
    sets: Sets,
    restores: Restores,
    live: Live,
    bus: str,
    unit: int,
    wanted: RestoreRequest,
) -> RestoreShown:
    """Read the unit and list the rows that a restore would write. Nothing is written."""
    unit_or_404(live, bus, unit)
    selection = Selection(frozenset(wanted.include), frozenset(wanted.exclude), frozenset(wanted.ticked))
    rows = await wanted_rows(sets, unit, wanted.set, wanted.document, wanted.from_unit)
    return restore_json(await restores.plan(person, bus, unit, rows, selection))


@router.post("/restores/{restore_id}/start", status_code=202)
async def start_restore(
    person: Annotated[Person, START.permitted],
    restores: Restores,
    restore: KnownRestore,
    chosen: StartRestoreRequest | None = None,
) -> RestoreShown:
    """Write the selected rows, unless the unit has changed since the plan."""
    if chosen is not None and (chosen.include is not None or chosen.exclude is not None):
        planned = restore.selection
        include = planned.include if chosen.include is None else frozenset(chosen.include)
        exclude = planned.exclude if chosen.exclude is None else frozenset(chosen.exclude)
        restores.select(person, restore, planned.choosing(include, exclude))
    restores.start(person, restore)
    return restore_json(restore)


@router.post("/restores/{restore_id}/cancel", status_code=202)
async def cancel_restore(
    person: Annotated[Person, CANCEL.permitted], restores: Restores, restore: KnownRestore
) -> RestoreShown:
    """Stop after the current row."""
    restores.cancel(person, restore)
    return restore_json(restore)


@router.get("/restores/{restore_id}")
async def get_restore(_: Viewer, restore: KnownRestore) -> RestoreShown:
    """Progress of the restore, row by row."""
    return restore_json(restore)

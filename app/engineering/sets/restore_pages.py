"""The pages of a restore: choose a set, review each row, follow the writes, read what a full read found."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Form, Request, Response
from starlette.responses import RedirectResponse

from app.core.web.access import Person
from app.core.web.routes import GuardedRoute
from app.core.web.templating import render
from app.engineering.sets.lookup import FILE_FORM, Chosen, KnownRestore, Restores, Sets, offers, side
from app.engineering.sets.model import compare
from app.engineering.sets.restore_api import Planner, rows_left_out, rows_to_write
from app.engineering.sets.restore_plan import OPERATING_VALUES, Restore, Selection
from app.engineering.sets.restore_service import CANCEL, START, RestoreService
from app.errors import Problem
from app.line.live.api.routes import Live
from app.line.live.bus_live import LiveState
from app.line.live.requests import unit_or_404
from bus.catalogue.parameters import PARAMETERS
from bus.messages import Message

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

Ticks = Annotated[list[int] | None, Form()]


@router.get("/units/{bus}/{unit}/restore")
async def restore_page(
    request: Request, _: Planner, sets: Sets, restores: Restores, live: Live, bus: str, unit: int
) -> Response:
    """Offer the sets that the unit can be restored from, and its earlier restores."""
    live_unit = unit_or_404(live, bus, unit)
    return render(
        request,
        "sets/restore.html",
        bus=bus,
        unit=live_unit,
        offers=offers(live, await sets.summaries(), bus, unit),
        earlier=await restores.of_unit(bus, unit),
    )


@router.post("/units/{bus}/{unit}/restore", **FILE_FORM)
async def plan_page(
    person: Planner, sets: Sets, restores: Restores, live: Live, bus: str, unit: int, chosen: Chosen
) -> Response:
    """Read the unit and plan a restore; nothing is written."""
    unit_or_404(live, bus, unit)
    rows = await chosen.uploaded(unit)
    if rows is None:
        if not chosen.text.startswith(("set:", "golden:")):
            raise Problem(422, "invalid", Message("set_or_file_missing"))
        rows = (await side(chosen.text, sets, live)).rows
    restore = await restores.plan(person, bus, unit, rows)
    return RedirectResponse(f"/restores/{restore.id}", 303)


@router.get("/restores/{restore_id}")
async def restore_progress(request: Request, _: Planner, restore: KnownRestore) -> Response:
    """Show the review before the start, then the progress, then the result."""
    template = "sets/_restore.html" if request.headers.get("hx-request") else "sets/restoring.html"
    dangerous = {left.number for left in restore.left_out if PARAMETERS[left.number].dangerous}
    response = render(
        request,
        template,
        restore=restore,
        rows=rows_to_write(restore),
        left_out=rows_left_out(restore),
        tickable=dangerous,
        proven=compare(restore.wanted, restore.proven) if restore.proven else [],
        PARAMETERS=PARAMETERS,
    )
    if restore.state != "running":
        # The state has changed, and the buttons with it: render the complete part again.
        response.headers["HX-Retarget"] = response.headers["HX-Reselect"] = "#restore"
    return response


@router.post("/restores/{restore_id}/tick")
async def confirm_dangerous(
    person: Planner, restores: Restores, live: Live, old: KnownRestore, tick: Ticks = None
) -> Response:
    """Plan again with dangerous rows that a person has confirmed one by one."""
    selection = Selection(confirmed=old.selection.confirmed | frozenset(tick or ()))
    return await _planned_again(person, restores, live, old, selection)


@router.post("/restores/{restore_id}/again")
async def plan_again(person: Planner, restores: Restores, live: Live, old: KnownRestore) -> Response:
    """Plan a restore again: the done rows are equal now, the rest is reviewed."""
    deselected = frozenset(left.number for left in old.left_out if left.reason == "deselected")
    return await _planned_again(person, restores, live, old, Selection(exclude=deselected))


async def _planned_again(
    person: Person, restores: RestoreService, live: LiveState, old: Restore, selection: Selection
) -> Response:
    unit_or_404(live, old.bus, old.unit)
    fresh = await restores.plan(person, old.bus, old.unit, old.wanted, selection, for_swap=old.for_swap)
    return RedirectResponse(f"/restores/{fresh.id}", 303)


@router.post("/restores/{restore_id}/start")
async def start(
    person: Annotated[Person, START.permitted], restores: Restores, restore: KnownRestore, row: Ticks = None
) -> Response:
    """Write the rows that are ticked."""
    restores.select(person, restore, ticked(restore, frozenset(row or ())))
    restores.start(person, restore)
    return RedirectResponse(f"/restores/{restore.id}", 303)


@router.post("/restores/{restore_id}/cancel")
async def cancel(
    person: Annotated[Person, CANCEL.permitted], restores: Restores, restore: KnownRestore
) -> Response:
    """Stop after the current row."""
    restores.cancel(person, restore)
    return RedirectResponse(f"/restores/{restore.id}", 303)


def ticked(restore: Restore, rows: frozenset[int]) -> Selection:
    """Return the choice that a person made in a review. Raises Problem 422 for no row, and for a row that was
    not in the review."""
    reviewed = frozenset(write.number for write in restore.plan.writes)
    reviewed |= frozenset(write.number for write, _ in restore.offered)
    if not rows:
        raise Problem(422, "invalid", Message("no_row_chosen"))
    if rows - reviewed:
        raise Problem(422, "invalid", Message("not_what_was_reviewed"))
    return restore.selection.choosing(rows, reviewed - rows - OPERATING_VALUES)

"""The guided path of a unit swap."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request, Response

from app.commands.api import desk_of
from app.commands.desk import Desk
from app.errors import Problem
from app.live.lookup import unit_or_404
from app.sets.api import Events, Keeper, Live, Restores
from app.sets.lookup import is_running, set_or_404, unit_rows_or_404
from app.sets.restore import Restore
from app.swap.looking import look
from app.swap.rules import FACTORY_ADDRESS, STEPS, Advice, advice, done_steps
from app.web.access import Engineer
from app.web.templating import render

router = APIRouter(include_in_schema=False)

AskDesk = Annotated[Desk, Depends(desk_of)]


@router.get("/swap/{bus}/{unit}")
async def swap_page(
    request: Request, _: Engineer, keeper: Keeper, live: Live, bus: str, unit: int
) -> Response:
    """The path, and the sets that the spare can be restored from."""
    found = unit_or_404(live, bus, unit)
    sets = await keeper.store.summaries(bus, unit)
    golden = next((one.id for one in sets if unit in one.golden_for), None)
    return render(
        request,
        "swap/page.html",
        bus=bus,
        unit=found,
        sets=sets,
        chosen=golden or (sets[0].id if sets else None),
    )


@router.get("/swap/{bus}/{unit}/look")
async def look_again(
    request: Request,
    person: Engineer,
    live: Live,
    restores: Restores,
    desk: AskDesk,
    bus: str,
    unit: int,
    source: int | None = None,
) -> Response:
    """Read the wire, and say where the swap stands and what to do."""
    unit_or_404(live, bus, unit)
    restore = restores.newest(bus, unit)
    try:
        now = advice(await look(desk, live, person, bus, unit, restore))
    except Problem as problem:
        now = Advice("find", problem.detail, at_panel=False)
    return render(
        request,
        "swap/_steps.html",
        bus=bus,
        unit=unit,
        advice=now,
        factory=FACTORY_ADDRESS,
        steps=STEPS,
        done=done_steps(now.step),
        source=source,
    )


@router.post("/swap/{bus}/{unit}/restore")
async def begin_restore(
    person: Engineer,
    keeper: Keeper,
    restores: Restores,
    events: Events,
    live: Live,
    bus: str,
    unit: int,
    source: Annotated[int, Form()],
) -> Response:
    """Plan the restore of the spare; the review of it comes next."""
    unit_or_404(live, bus, unit)
    rows = unit_rows_or_404(await set_or_404(keeper, source), unit)
    restore: Restore = await restores.plan(person, bus, unit, rows, running=is_running(live.buses[bus], unit))
    await events.record(
        kind="swap",
        who=person.name,
        bus=bus,
        unit=unit,
        what=f"unit swapped: restore from set {source} planned, {len(restore.rows)} rows to write",
    )
    return Response(status_code=303, headers={"Location": f"/restores/{restore.id}"})

"""The guided path of a unit swap."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request, Response

from app.commands.api import desk_of
from app.commands.desk import Desk
from app.errors import Problem
from app.live.api import Live
from app.live.lookup import unit_or_404
from app.sets.api import Keeper, Restores
from app.sets.lookup import plan, set_or_404, unit_rows_or_404
from app.swap.desk import SwapDesk, latest, step_text
from app.swap.looking import look
from app.swap.rules import FACTORY_ADDRESS, STEPS, Advice, advice, done_steps
from app.web.access import Engineer
from app.web.templating import render

router = APIRouter(include_in_schema=False)


def swaps_of(request: Request) -> SwapDesk:
    """The app's one desk of swaps."""
    swaps: SwapDesk = request.app.state.services.swaps
    return swaps


AskDesk = Annotated[Desk, Depends(desk_of)]
Swaps = Annotated[SwapDesk, Depends(swaps_of)]


@router.get("/swap/{bus}/{unit}")
async def swap_page(
    request: Request, _: Engineer, keeper: Keeper, live: Live, swaps: Swaps, bus: str, unit: int
) -> Response:
    """What the spare shall become, then the path."""
    found = unit_or_404(live, bus, unit)
    sets = await keeper.store.summaries(bus, unit)
    golden = next((one.id for one in sets if unit in one.golden_for), None)
    swap = swaps.of(bus, unit)
    return render(
        request,
        "swap/page.html",
        bus=bus,
        unit=found,
        sets=sets,
        swap=swap,
        chosen=golden or (sets[0].id if sets else None),
    )


@router.post("/swap/{bus}/{unit}")
async def begin(
    person: Engineer,
    keeper: Keeper,
    live: Live,
    swaps: Swaps,
    bus: str,
    unit: int,
    source: Annotated[int, Form()],
) -> Response:
    """Begin it; nothing is sent to any unit but questions."""
    unit_or_404(live, bus, unit)
    unit_rows_or_404(await set_or_404(keeper, source), unit)
    await swaps.begin(person, bus, unit, source)
    return _to_swap(bus, unit)


@router.get("/swap/{bus}/{unit}/look")
async def look_again(
    request: Request, person: Engineer, live: Live, swaps: Swaps, desk: AskDesk, bus: str, unit: int
) -> Response:
    """Read the wire, and say where the swap stands and what to do."""
    unit_or_404(live, bus, unit)
    swap = swaps.of_or_404(bus, unit)
    try:
        sight = await latest(swap, lambda: look(desk, live, person, swap))
        now = Advice("find", "reading the wire", at_panel=False) if sight is None else advice(sight)
    except Problem as problem:
        now = Advice("find", problem.detail, at_panel=False)
    baud = live.buses[bus].baud
    return render(
        request,
        "swap/_steps.html",
        bus=bus,
        unit=unit,
        advice=now,
        swap=swap,
        text=step_text(now, swap),
        words={"target": unit, "factory": FACTORY_ADDRESS, "baud": baud, "hundreds": baud // 100},
        steps=STEPS,
        done=done_steps(now.step),
    )


@router.post("/swap/{bus}/{unit}/spare")
async def it_is_the_spare(_: Engineer, swaps: Swaps, bus: str, unit: int) -> Response:
    """What answers at the section's address is the spare: a person has looked."""
    swap = swaps.of_or_404(bus, unit)
    swap.is_new = True
    swap.seen.append("a person said that it is the spare")
    return _to_swap(bus, unit)


@router.post("/swap/{bus}/{unit}/restore")
async def begin_restore(
    person: Engineer, keeper: Keeper, restores: Restores, live: Live, swaps: Swaps, bus: str, unit: int
) -> Response:
    """Plan the restore of the spare; the review of it comes next."""
    unit_or_404(live, bus, unit)
    swap = swaps.of_or_404(bus, unit)
    rows = unit_rows_or_404(await set_or_404(keeper, swap.source), unit)
    swap.restore = await plan(restores, person, live.buses[bus], unit, rows)
    return Response(status_code=303, headers={"Location": f"/restores/{swap.restore.id}"})


@router.post("/swap/{bus}/{unit}/give-up")
async def give_up(person: Engineer, swaps: Swaps, bus: str, unit: int) -> Response:
    """Leave it; whatever was done at the unit stays."""
    await swaps.give_up(person, swaps.of_or_404(bus, unit))
    return Response(status_code=303, headers={"Location": f"/units/{bus}/{unit}"})


def _to_swap(bus: str, unit: int) -> Response:
    return Response(status_code=303, headers={"Location": f"/swap/{bus}/{unit}"})

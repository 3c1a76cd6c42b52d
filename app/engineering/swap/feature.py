"""The feature of unit swaps: pages that lead a person through a replacement."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from starlette.responses import RedirectResponse

from app.core.database import Database
from app.core.find.finders import Finders, FoundPlace, Search, matched
from app.core.web.access import Person
from app.core.web.routes import GuardedRoute
from app.core.web.services import service
from app.core.web.templating import render
from app.engineering.sets.api import ParameterSets
from app.engineering.sets.lookup import (
    FILE_FORM,
    Chosen,
    Restores,
    Sets,
    offers,
    set_or_404,
    unit_rows_or_404,
)
from app.engineering.sets.restore_api import RestoreOmission, rows_left_out
from app.engineering.sets.restore_service import RestoreService
from app.engineering.sets.saving import SetKeeper
from app.engineering.swap.rules import PROVEN, STEPS, Advice, advice, done_steps
from app.engineering.swap.service import (
    ACTS,
    BEGIN,
    CANCEL,
    CONFIRM_SPARE,
    RESTORE_SPARE,
    SAVE_ENTERED,
    Swap,
    SwapService,
    SwapStore,
    step_text,
)
from app.errors import Problem
from app.feature import Feature, Services
from app.line.commands.service import CommandService
from app.line.live.api.routes import Live
from app.line.live.bus_live import LiveState, unit_link_now
from app.line.live.diagnosis import no_response_text
from app.line.live.fields import name_on_site, unit_key
from app.line.live.requests import unit_or_404
from app.people.audit.log import EventLog
from bus.instants import unix_now
from bus.messages import Message

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

Swaps = Annotated[SwapService, service(SwapService)]
Beginner = Annotated[Person, BEGIN.permitted]


@router.get("/swap/{bus}/{unit}")
async def swap_page(
    request: Request, _: Beginner, sets: Sets, live: Live, swaps: Swaps, bus: str, unit: int
) -> Response:
    """Offer the sets that the spare can equal or, during a swap, show its steps."""
    return await _page(request, sets, live, swaps, bus, unit)


async def _page(
    request: Request,
    sets: Sets,
    live: LiveState,
    swaps: SwapService,
    bus: str,
    unit: int,
    error: Message | None = None,
) -> Response:
    found = unit_or_404(live, bus, unit)
    return render(
        request,
        "swap/page.html",
        bus=bus,
        unit=found,
        fault=no_response_text(live.buses[bus], unix_now()),
        responds=unit_link_now(live.buses[bus], found, unix_now()) == "online",
        offers=offers(live, await sets.summaries(), bus, unit),
        swap=swaps.find(bus, unit),
        error=error,
        status=422 if error else 200,
    )


@router.post("/swap/{bus}/{unit}", **FILE_FORM)
async def begin(
    request: Request,
    person: Beginner,
    sets: Sets,
    live: Live,
    swaps: Swaps,
    bus: str,
    unit: int,
    chosen: Chosen,
) -> Response:
    """Begin a swap; units are only read. Without a source the form says so at its field."""
    unit_or_404(live, bus, unit)
    if not chosen.file and not chosen.text:
        return await _page(request, sets, live, swaps, bus, unit, Message("spare_not_chosen"))
    source = await swaps.source_of(person, bus, unit, chosen)
    await swaps.begin(person, bus, unit, source)
    return RedirectResponse(f"/swap/{bus}/{unit}", 303)


async def swap_or_404(live: Live, swaps: Swaps, bus: str, unit: int) -> Swap:
    unit_or_404(live, bus, unit)
    return swaps.find_or_404(bus, unit)


SwapOfUnit = Annotated[Swap, Depends(swap_or_404)]
"""The swap of the ``{bus}`` and ``{unit}`` of the path."""


@router.get("/swap/{bus}/{unit}/look")
async def look_again(request: Request, person: Beginner, swaps: Swaps, swap: SwapOfUnit) -> Response:
    """Probe the wire; show the state of the swap and its next step."""
    now = PROVEN if swap.proven else await _advice(person, swaps, swap)
    return render(
        request,
        "swap/_steps.html",
        bus=swap.bus,
        unit=swap.unit,
        advice=now,
        swap=swap,
        setpoints=_setpoints_left(swap),
        text=step_text(now, swap),
        steps=STEPS,
        done=done_steps(now.step),
        at=swap.state.read_at if swap.state else None,
    )


async def _advice(person: Person, swaps: SwapService, swap: Swap) -> Advice:
    try:
        state = await swaps.look(person, swap)
    except Problem as problem:
        return Advice("find", problem.message, at_keypad=False)
    return Advice("find", Message("swap_reading"), at_keypad=False) if state is None else advice(state)


@router.post("/swap/{bus}/{unit}/spare")
async def confirm_spare(
    person: Annotated[Person, CONFIRM_SPARE.permitted], swaps: Swaps, swap: SwapOfUnit
) -> Response:
    """Confirm that the unit at the section's address is the spare."""
    await swaps.confirm_spare(person, swap)
    return RedirectResponse(f"/swap/{swap.bus}/{swap.unit}", 303)


@router.post("/swap/{bus}/{unit}/restore")
async def restore_spare(
    person: Annotated[Person, RESTORE_SPARE.permitted],
    sets: Sets,
    restores: Restores,
    swaps: Swaps,
    swap: SwapOfUnit,
) -> Response:
    """Plan the restore of the spare and go to its review."""
    if swap.source is None:
        raise Problem(409, "no_set", Message("swap_without_set"))
    rows = unit_rows_or_404(await set_or_404(sets, swap.source.set), swap.source.unit)
    restore = await restores.plan(person, swap.bus, swap.unit, rows, for_swap=True)
    await swaps.begin_restore(person, swap, restore)
    return RedirectResponse(f"/restores/{restore.id}", 303)


@router.post("/swap/{bus}/{unit}/entered")
async def save_entered(
    person: Annotated[Person, SAVE_ENTERED.permitted],
    keeper: ParameterSets,
    swaps: Swaps,
    swap: SwapOfUnit,
) -> Response:
    """Read the unit, whose values came from the sheet, and save it as a set."""
    if swap.source is not None:
        raise Problem(409, "not_in_state", Message("swap_with_set"))
    kept = await keeper.read_and_save(person, [swap.unit], origin="from the sheet")
    await swaps.save_entered(person, swap, kept)
    return RedirectResponse(f"/sets/{kept.id}", 303)


@router.post("/swap/{bus}/{unit}/give-up")
async def cancel(person: Annotated[Person, CANCEL.permitted], swaps: Swaps, swap: SwapOfUnit) -> Response:
    """Close the swap; all changes at the unit stay."""
    await swaps.cancel(person, swap)
    return RedirectResponse(f"/units/{swap.bus}/{swap.unit}", 303)


def _setpoints_left(swap: Swap) -> list[RestoreOmission]:
    """Return the setpoints of the old unit that were not selected for the spare."""
    if swap.restore is None or not swap.proven:
        return []
    return [row for row in rows_left_out(swap.restore) if row.reason_code == "operating_value"]


def make(services: Services) -> None:
    commands, keepers = services.of_buses(CommandService), services.of_buses(SetKeeper)
    store, restores, events = SwapStore(services[Database]), services[RestoreService], services[EventLog]
    swaps = services.add(SwapService(services[LiveState], commands, keepers, restores, store, events))
    services.lifespan.add("swaps", start=swaps.load)
    services[Finders].add("find_actions", partial(_find, services[LiveState]))


async def _find(live: LiveState, search: Search) -> Iterable[FoundPlace]:
    """Find the pages for replacing a unit, also by the unit's name."""
    found: list[FoundPlace] = []
    for bus in live.buses.values() if search.may("begin_swap") else ():
        for unit in bus.units.values():
            name = name_on_site(bus.settings.name, unit.settings.name, live.buses)
            label = Message.of("find_replace", unit=name)
            href = f"/swap/{unit_key(bus.settings.name, unit.settings.id)}"
            names = map(search.language.t, (label, Message("find_words_replace")))
            places = matched(search, FoundPlace(label, href), *names, *unit.names)
            # Whoever types the name of a unit wants the unit, before its replacement.
            found += (place._replace(rank=place.rank + 1) for place in places)
    return found


FEATURE = Feature(make, (router,), ACTS)

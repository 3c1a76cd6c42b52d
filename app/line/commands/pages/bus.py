"""The bus page: wire statistics, responses of each unit, the trace, a scan, the baud rate."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Form
from starlette.responses import RedirectResponse, Response

from app.core.web.access import Person, Viewer
from app.core.web.arrival import Deadline
from app.errors import Problem
from app.line.commands.catalogue import CHANGE_BAUD, SCAN_BUS
from app.line.commands.forms.page_context import BusPage, OfBus, Page, new_id
from app.line.commands.limits import MAX_READ_ONLY_MINUTES
from app.line.commands.pages.control import others
from app.line.commands.review import outcome_text
from app.line.commands.safeguards import END_READ_ONLY, SET_READ_ONLY
from app.line.commands.service.writer import permitted
from bus.contract import ChangeBaud, ScanBus
from bus.errors import unit_error
from bus.messages import Message
from bus.settings import BAUDS
from bus.text import OneLine

router = APIRouter(prefix="/bus", include_in_schema=False)
SEE_OTHER = 303
DEFAULT_MINUTES = 60


@router.get("")
async def first_bus(_: Viewer, page: Page) -> Response:
    """Lead to the first bus, whose page leads to the others."""
    first = next(iter(page.live.buses), None)
    if first is None:
        raise Problem(404, "unknown_bus", Message("no_bus_configured"))
    return RedirectResponse(f"/bus/{first}", SEE_OTHER)


@router.get("/{bus}")
async def bus_page(_: Viewer, page: OfBus) -> Response:
    """One bus."""
    return page.render(
        "bus/page.html",
        buses=list(page.live.buses),
        bauds=sorted(BAUDS),
        control_required=page.guards.control.required,
        bus=page.bus,
        control=page.guards.bus_control(),
        others=others(page),
        read_only=page.guards.read_only(),
        fault="",
        **_units(page),
    )


@router.post("/{bus}/read-only")
async def set_read_only(
    person: Annotated[Person, SET_READ_ONLY.permitted],
    page: OfBus,
    reason: Annotated[OneLine, Form(max_length=200)] = "",
    minutes: Annotated[int, Form(ge=1, le=MAX_READ_ONLY_MINUTES)] = DEFAULT_MINUTES,
) -> Response:
    """Refuse every write to this bus for a time, with the reason shown on every page."""
    if not reason.strip():
        raise Problem(422, "invalid", Message("read_only_needs_reason"))
    await page.guards.set_read_only(person, reason.strip(), minutes)
    return RedirectResponse(f"/bus/{page.name}#read-only", SEE_OTHER)


@router.post("/{bus}/read-only/end")
async def end_read_only(person: Annotated[Person, END_READ_ONLY.permitted], page: OfBus) -> Response:
    """Let commands through again; the event records the user."""
    await page.guards.end_read_only(person)
    return RedirectResponse(f"/bus/{page.name}#read-only", SEE_OTHER)


@router.get("/{bus}/units")
async def unit_rows(_: Viewer, page: OfBus) -> Response:
    """The counters of every unit, for the open page."""
    return page.render("bus/_units.html", **_units(page))


def _units(page: BusPage) -> dict[str, Any]:
    figures = {} if page.bus.figures is None else {unit.unit: unit for unit in page.bus.figures.units}
    rows = [{"unit": page.shown(number), "figures": figures.get(number)} for number in page.bus.units]
    return {"fields": page.fields(), "rows": rows, "unit_error": unit_error}


@router.post("/{bus}/scan", dependencies=[permitted(SCAN_BUS)])
async def scan(
    page: OfBus,
    first: Annotated[int, Form(ge=1, le=255)] = 1,
    last: Annotated[int, Form(ge=1, le=255)] = 255,
) -> Response:
    """Find the addresses that respond, in the gaps of the scan."""
    action = ScanBus(first=min(first, last), last=max(first, last))
    result = await page.send(action, new_id())
    return page.render(
        "bus/_found.html",
        outcome=outcome_text(result),
        found=result.found,
        remarks=result.message,
        known=page.bus.units,
        action=action,
    )


CHANGE_S = 30.0
"""Every unit written, looked for at two rates, and written back if need be."""


@router.get("/{bus}/baud", dependencies=[permitted(CHANGE_BAUD)])
async def review_baud(page: OfBus, baud: int) -> Response:
    """The second step; nothing has been sent."""
    if baud not in BAUDS:
        raise Problem(422, "invalid", Message.of("baud_unknown", rates=", ".join(map(str, BAUDS))))
    if baud == page.bus.baud:
        raise Problem(422, "invalid", Message.of("baud_unchanged", baud=baud))
    return page.review("bus/_review_baud.html", bus=page.bus, baud=baud)


@router.post("/{bus}/baud", dependencies=[permitted(CHANGE_BAUD)])
async def change_baud(
    page: OfBus,
    baud: Annotated[int, Form()],
    id: Annotated[str, Form(min_length=8, max_length=200)],
) -> Response:
    """Change it at every unit; a result for each."""
    result = await page.send(ChangeBaud(baud=baud), id, Deadline(page.made_at, CHANGE_S))
    return page.render("bus/_baud_done.html", bus=page.bus, outcome=outcome_text(result), result=result)

"""The bus page: wire statistics, responses of each unit, a scan, the baud rate, the read-only mode; control
of the bus from any page, and the undo of commands to it."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Form
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.web.access import Person, Role, Viewer
from app.core.web.arrival import Deadline
from app.core.web.routes import GuardedRoute
from app.core.web.services import service_of
from app.core.web.templating import render
from app.errors import Problem
from app.line.commands.catalogue import CHANGE_BAUD, SCAN_BUS
from app.line.commands.limits import MAX_READ_ONLY_MINUTES
from app.line.commands.page_context import BusPage, Page, PageOfBus, UnitPage, new_id
from app.line.commands.pages.line import review_change
from app.line.commands.pages.speed import review_setpoint
from app.line.commands.pages.unit import review_analog_value, review_switch, review_value
from app.line.commands.review import outcome_text
from app.line.commands.safeguards import END_READ_ONLY, FORCE_CONTROL, SET_READ_ONLY, TAKE_CONTROL
from app.line.commands.service import END_SCAN, permitted
from app.line.commands.undo import PlaceKind, UndoOffer
from app.line.live.bus_live import BusLive
from app.line.live.diagnosis import connection_cause
from app.line.live.hub import Hub
from bus.catalogue.parameters import BAUD_RATE
from bus.contract import (
    ChangeBaud,
    ScanBus,
    SetLine,
    SetSpeed,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.errors import unit_error
from bus.instants import unix_now
from bus.messages import Message, term
from bus.settings import BAUDS
from bus.validation import OneLine, TypedText

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)
SEE_OTHER = 303
DEFAULT_MINUTES = 60
SCAN_WAIT_S = 1.0
"""The time that the press waits for the result of a scan; a page then follows it."""


@router.get("/bus")
async def first_bus(_: Viewer, page: Page) -> Response:
    """Redirect to the first bus, whose page leads to the others."""
    first = next(iter(page.live.buses), None)
    if first is None:
        raise Problem(404, "unknown_bus", Message("no_bus_configured"))
    return RedirectResponse(f"/bus/{first}", SEE_OTHER)


@router.get("/bus/{bus}")
async def bus_page(_: Viewer, page: PageOfBus) -> Response:
    """Show one bus."""
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
        stored_bauds=_stored_bauds(page.bus),
        begun=False,
        **(_last_scan(page) | _units(page)),
    )


def _stored_bauds(bus: BusLive) -> dict[int, list[str]]:
    """Return the units whose baud rate (#18), as last read, is not that of the bus, by that rate: they use
    it from their next power-up."""
    stored: dict[int, list[str]] = {}
    for unit in bus.units.values():
        raw = unit.parameter_raw(BAUD_RATE)
        if raw is not None and raw * 100 != bus.baud:
            stored.setdefault(raw * 100, []).append(unit.settings.name)
    return stored


@router.post("/bus/{bus}/read-only")
async def set_read_only(
    person: Annotated[Person, SET_READ_ONLY.permitted],
    page: PageOfBus,
    reason: Annotated[OneLine, Form(max_length=200)] = "",
    minutes: Annotated[int, Form(ge=1, le=MAX_READ_ONLY_MINUTES)] = DEFAULT_MINUTES,
) -> Response:
    """Refuse every write to this bus for a time, with the reason shown on every page."""
    if not reason.strip():
        raise Problem(422, "invalid", Message("read_only_needs_reason"))
    await page.guards.set_read_only(person, reason.strip(), minutes)
    return RedirectResponse(f"/bus/{page.name}#read-only", SEE_OTHER)


@router.post("/bus/{bus}/read-only/end")
async def end_read_only(person: Annotated[Person, END_READ_ONLY.permitted], page: PageOfBus) -> Response:
    """Accept commands to this bus again; the event records the user."""
    await page.guards.end_read_only(person)
    return RedirectResponse(f"/bus/{page.name}#read-only", SEE_OTHER)


@router.get("/bus/{bus}/units")
async def unit_rows(_: Viewer, page: PageOfBus) -> Response:
    """Show the counters of every unit, for the open page."""
    return page.render("bus/_units.html", **_units(page))


def _units(page: BusPage) -> dict[str, Any]:
    last = page.bus.figures or page.bus.figures_before
    figures = {} if last is None else {unit.unit: unit for unit in last.units}
    rows = [{"unit": page.shown(number), "figures": figures.get(number)} for number in page.bus.units]
    shown = {"fields": page.fields(), "name": page.name, "silent": connection_cause(page.bus, unix_now())}
    return {"rows": rows, "unit_error": unit_error, **shown}


@router.post("/bus/{bus}/scan", dependencies=[permitted(SCAN_BUS)])
async def scan(
    page: PageOfBus,
    first: Annotated[int, Form(ge=1, le=255)] = 1,
    last: Annotated[int, Form(ge=1, le=255)] = 255,
) -> Response:
    """Find the addresses that respond, in the gaps of the scan. The page follows a long scan, and may be
    left."""
    before = page.commands.last_scan
    try:
        # The command itself goes on when this wait ends.
        await asyncio.wait_for(
            page.send(ScanBus(first=min(first, last), last=max(first, last)), new_id()), SCAN_WAIT_S
        )
    except TimeoutError as error:
        if page.commands.last_scan is before:
            raise Problem(504, "not_sent", Message("deadline_passed")) from error
    return page.render("bus/_found.html", begun=True, **_last_scan(page))


@router.get("/bus/{bus}/scan", dependencies=[permitted(SCAN_BUS)])
async def last_scan(page: PageOfBus) -> Response:
    """Show the scan of addresses that is under way, or the result of the last one."""
    return page.render("bus/_found.html", begun=False, **_last_scan(page))


def _last_scan(page: BusPage) -> dict[str, Any]:
    scan = page.commands.last_scan
    result = None if scan is None or scan.result is None else page.in_words(scan.result)
    outcome = None if result is None else outcome_text(result)
    return {"scan": scan, "result": result, "outcome": outcome, "known": page.bus.units, "name": page.name}


@router.post("/bus/{bus}/scan/end")
async def end_scan(person: Annotated[Person, END_SCAN.permitted], page: PageOfBus) -> Response:
    """End a scan after the address under way; the page that follows it shows what it found."""
    await page.commands.end_scans(person)
    return Response(status_code=204)


CHANGE_S = 30.0
"""The seconds to write every unit, look for it at two rates, and write it back if need be."""


@router.get("/bus/{bus}/baud", dependencies=[permitted(CHANGE_BAUD)])
async def review_baud(page: PageOfBus, baud: int) -> Response:
    """Review a new baud rate."""
    if baud not in BAUDS:
        raise Problem(422, "invalid", Message.of("baud_unknown", rates=", ".join(map(str, BAUDS))))
    if baud == page.bus.baud:
        raise Problem(422, "invalid", Message.of("baud_unchanged", baud=baud))
    return page.review("bus/_review_baud.html", bus=page.bus, baud=baud)


@router.post("/bus/{bus}/baud", dependencies=[permitted(CHANGE_BAUD)])
async def change_baud(
    page: PageOfBus,
    baud: Annotated[int, Form()],
    id: Annotated[str, Form(min_length=8, max_length=200)],
) -> Response:
    """Change the baud rate of every unit, and show a result for each."""
    result = await page.send(ChangeBaud(baud=baud), id, Deadline(page.made_at, CHANGE_S))
    return page.render("bus/_baud_done.html", bus=page.bus, outcome=outcome_text(result), result=result)


ControlStep = Literal["take", "release", "request", "decline", "withdraw", "grant", "hand-over"]
TEMPLATES = {
    "head": "components/_head_control.html",
    "offer": "components/_control_offer.html",
    "bus": "bus/_control.html",
}
ControlPlace = Literal["head", "offer", "bus"]


@router.get("/control")
async def head_control(request: Request, _: Viewer, bus: str = "") -> Response:
    """Show who holds control, in the head of an open page. ``bus``: the name of its bus, or empty."""
    return render(request, TEMPLATES["head"], of_bus=bus, fault="")


@router.get("/bus/{bus}/control/{place}")
async def control_now(_: Viewer, page: PageOfBus, place: ControlPlace) -> Response:
    """Show who holds control of one bus, in a place of the page."""
    return _shown(page, place)


@router.post("/bus/{bus}/control")
async def control(
    person: Annotated[Person, TAKE_CONTROL.permitted],
    page: PageOfBus,
    do: Annotated[ControlStep, Form()],
    place: Annotated[ControlPlace, Form()] = "head",
    of_bus: Annotated[str, Form(max_length=40)] = "",
    to: Annotated[TypedText, Form(max_length=80)] = "",
) -> Response:
    """Take one step with control of this bus, and show why it had no effect if another user was quicker."""
    fault: str | Message = ""
    try:
        match do:
            case "take":
                await page.guards.take(person)
            case "release":
                await page.guards.release(person)
            case "request":
                await page.guards.request(person)
            case "grant":
                await page.guards.grant(person, shown=to)
            case "decline":
                await page.guards.end_request(person, shown=to)
            case "withdraw":
                await page.guards.end_request(person, shown=person.account)
            case _ if to in others(page):
                await page.guards.hand_over(person, to)
            case _:
                fault = Message("new_holder_unknown")
    except Problem as problem:
        fault = problem.message
    return _shown(page, place, fault=fault, of_bus=of_bus)


def _shown(page: BusPage, place: ControlPlace, *, fault: str | Message = "", of_bus: str = "") -> Response:
    more: dict[str, Any] = {"of_bus": of_bus}
    if place != "head":
        more = {"bus": page.bus, "control": page.guards.bus_control(), "others": others(page)}
    return page.render(TEMPLATES[place], fault=fault, **more)


def others(page: BusPage) -> list[str]:
    """Return the users with an open page who may set a line and do not hold control of this one."""
    here = {
        name
        for name, role in service_of(page.request, Hub).people().items()
        if Role(role).includes(TAKE_CONTROL.role)
    }
    if page.person.role.includes(FORCE_CONTROL.role):
        here.add(page.person.account)
    return sorted(here - {page.guards.bus_control().holder})


@router.get("/bus/{bus}/undo")
async def newest_undo(
    person: Viewer, page: PageOfBus, unit: int | None = None, kind: PlaceKind | None = None
) -> Response:
    """Offer the undo of the newest command to ``unit``, of a ``kind`` if it is given; without a unit of the
    newest change of setpoints of the bus, because a parameter may be one of several that were written
    together. Nothing if there is none."""
    units, kind = (page.bus.units.keys(), "setpoint") if unit is None else ({unit}, kind)
    offer = page.commands.undo.newest(person, units, kind, names_unit=unit is None)
    return page.render("components/_undo.html", undo=offer, kind=kind)


@router.get("/bus/{bus}/undo/{id}")
async def review_undo(person: Viewer, page: PageOfBus, id: str) -> Response:
    """Review the undo of one command: an ordinary command back to what was there before."""
    offer = page.commands.undo.offer(person, id)
    try:
        if offer is None:
            raise Problem(409, "moved", Message("undo_over"))
        return await _review(page, offer)
    except Problem as problem:
        return page.refused(problem, page.translator.t(term("Undo")))


async def _review(page: BusPage, offer: UndoOffer) -> Response:
    action = offer.action
    if isinstance(action, SetLine):
        page.undoes = offer.id
        return await review_change(page, action.setpoints)
    unit = UnitPage(page.request, page.name, action.units[0])
    unit.undoes = offer.id
    match action:
        case SetSpeed(raw=raw):
            return await review_setpoint(unit, raw)
        case WriteOutput(number=number, on=on):
            return review_switch(unit, number, on=on)
        case WriteAnalogOutput(raw=raw):
            return review_analog_value(unit, raw)
        case WriteParameter(number=number, raw=raw):
            return await review_value(unit, number, raw)
    raise TypeError(type(action))

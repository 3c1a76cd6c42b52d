"""Control of a bus from any page: in the head, and in place where a command was refused for want of it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Form
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.access import Person, Role, Viewer
from app.core.web.templating import render
from app.errors import Problem
from app.line.commands.forms.page_context import BusPage, OfBus
from app.line.commands.safeguards import FORCE_CONTROL, TAKE_CONTROL
from bus.messages import Message
from bus.text import TypedText

router = APIRouter(include_in_schema=False)
ControlStep = Literal["take", "release", "request", "decline", "withdraw", "grant", "hand-over"]
TEMPLATES = {
    "head": "components/_head_control.html",
    "offer": "components/_control_offer.html",
    "bus": "bus/_control.html",
}
ControlPlace = Literal["head", "offer", "bus"]


@router.get("/control")
async def head_control(request: Request, _: Viewer, bus: str = "") -> Response:
    """Who holds control, for the head of an open page. ``bus``: the page's, empty where it has none."""
    return render(request, TEMPLATES["head"], of_bus=bus, fault="")


@router.get("/bus/{bus}/control/{place}")
async def control_now(_: Viewer, page: OfBus, place: ControlPlace) -> Response:
    """The same for one bus, in a place of the page."""
    return _shown(page, place)


@router.post("/bus/{bus}/control")
async def control(
    person: Annotated[Person, TAKE_CONTROL.permitted],
    page: OfBus,
    do: Annotated[ControlStep, Form()],
    place: Annotated[ControlPlace, Form()] = "head",
    of_bus: Annotated[str, Form(max_length=40)] = "",
    to: Annotated[TypedText, Form(max_length=80)] = "",
) -> Response:
    """One step with control of this bus; states why it had no effect, where another user was quicker."""
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
    """Users with an open page who may set a line and do not hold this one."""
    here = {name for name, role in page.people().items() if Role(role).includes(TAKE_CONTROL.role)}
    if page.person.role.includes(FORCE_CONTROL.role):
        here.add(page.person.account)
    return sorted(here - {page.guards.bus_control().holder})

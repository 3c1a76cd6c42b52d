"""The bus page: what the wire carries, how each unit answers, the frames as they pass, a scan."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Form
from starlette.responses import RedirectResponse, Response

from app.commands.catalogue import SCAN_BUS
from app.commands.forms.page_context import Page, PageContext, new_id
from app.commands.safeguards.control import LAPSES_AFTER_S
from app.commands.service.writer import permitted
from app.errors import Problem
from app.web.access import Operator, Person, Role, Viewer
from bus.contract import ScanBus, UnitFigures
from bus.errors import unit_error
from bus.messages import Message
from bus.settings import BAUDS

router = APIRouter(prefix="/bus", include_in_schema=False)
SEE_OTHER = 303


@router.get("")
async def first_bus(_: Viewer, desk: Page) -> Response:
    """The first of them; the page leads to the others."""
    names = list(desk.live.buses)
    if not names:
        raise Problem(404, "unknown_bus", Message("no_bus_configured"))
    return RedirectResponse(f"/bus/{names[0]}", SEE_OTHER)


@router.get("/{bus}")
async def bus_page(person: Viewer, desk: Page, bus: str) -> Response:
    """One bus."""
    live = desk.bus(bus)
    return desk.render(
        "bus/page.html",
        fields=desk.fields(),
        bus=live,
        buses=list(desk.live.buses),
        rows=_rows(desk, bus),
        bauds=sorted(BAUDS),
        control_required=desk.guards(bus).control.required,
        **_control(desk, person, bus),
    )


@router.get("/{bus}/units")
async def unit_rows(_: Viewer, desk: Page, bus: str) -> Response:
    """The counters of every unit, for the open page."""
    return desk.render("bus/_units.html", fields=desk.fields(), bus=desk.bus(bus), rows=_rows(desk, bus))


def _rows(desk: PageContext, bus: str) -> list[dict[str, object]]:
    live = desk.bus(bus)
    figures = {unit.unit: unit for unit in live.figures.units} if live.figures is not None else {}
    return [_row(desk, bus, number, figures.get(number)) for number in live.units]


def _row(desk: PageContext, bus: str, number: int, figures: UnitFigures | None) -> dict[str, object]:
    voice = desk.voice
    naks = figures.naks if figures is not None else {}
    return {
        "unit": desk.shown(bus, number),
        "figures": figures,
        "naks": ", ".join(f"{count} x {voice.t(unit_error(code))}" for code, count in sorted(naks.items())),
        "median": _ms(desk, figures.answer_s_median if figures is not None else None),
        "p99": _ms(desk, figures.answer_s_p99 if figures is not None else None),
        "most": _ms(desk, figures.answer_s_max if figures is not None else None),
    }


def _ms(desk: PageContext, seconds: float | None) -> str:
    return desk.voice.formats.number(None if seconds is None else 1000 * seconds, 1)


@router.post("/{bus}/scan")
async def scan(
    person: Annotated[Person, permitted(SCAN_BUS)],
    desk: Page,
    bus: str,
    first: Annotated[int, Form(ge=1, le=255)] = 1,
    last: Annotated[int, Form(ge=1, le=255)] = 255,
) -> Response:
    """Which addresses answer, in the gaps of the scan."""
    desk.bus(bus)
    action = ScanBus(first=min(first, last), last=max(first, last))
    result = await desk.ask(person, bus, action, new_id())
    return desk.render(
        "bus/_found.html",
        outcome=desk.outcome(result),
        found=result.found,
        remarks=result.message,
        known=desk.bus(bus).units,
        action=action,
    )


@router.get("/{bus}/control")
async def control_now(person: Viewer, desk: Page, bus: str) -> Response:
    """Who holds control, for the open page."""
    return _control_part(desk, person, bus)


@router.post("/{bus}/control")
async def control(
    person: Operator,
    desk: Page,
    bus: str,
    do: Annotated[str, Form(pattern="^(take|release|hand-over)$")],
    to: Annotated[str, Form(max_length=80)] = "",
) -> Response:
    """Take, give back or hand over control of this line; who was quicker is said in its place."""
    desk.bus(bus)
    try:
        await _move_control(desk, person, bus, do, to)
    except Problem as problem:
        return _control_part(desk, person, bus, fault=desk.voice.t(problem.message))
    return _control_part(desk, person, bus)


async def _move_control(desk: PageContext, person: Person, bus: str, do: str, to: str) -> None:
    match do:
        case "take":
            await desk.guards(bus).take(person)
        case "release":
            await desk.guards(bus).release(person)
        case _:
            if to not in _others(desk, person, bus):
                raise Problem(422, "invalid", Message("new_holder_unknown"))
            await desk.guards(bus).hand_over(person, to)


def _control_part(desk: PageContext, person: Person, bus: str, fault: str = "") -> Response:
    context = _control(desk, person, bus) | {"fault": fault}
    return desk.render("bus/_control.html", bus=desk.bus(bus), **context)


def _control(desk: PageContext, person: Person, bus: str) -> dict[str, Any]:
    return {
        "fault": "",
        "holding": desk.guards(bus).holding(),
        "others": _others(desk, person, bus),
        "lapses_min": round(LAPSES_AFTER_S / 60),
    }


def _others(desk: PageContext, person: Person, bus: str) -> list[str]:
    """Who is here, may set a line and does not hold this one; an admin may take it this way."""
    holder = desk.guards(bus).holder()
    here = {name for name, role in desk.people().items() if Role(role).includes(Role.OPERATOR)}
    if person.role.includes(Role.ADMIN):
        here.add(person.account)
    return sorted(here - {holder})

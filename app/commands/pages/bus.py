"""The bus page: wire statistics, responses of each unit, the trace, a scan, the baud rate."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Form
from starlette.responses import RedirectResponse, Response

from app.commands.acts import FORCE_CONTROL, TAKE_CONTROL
from app.commands.catalogue import CHANGE_BAUD, SCAN_BUS
from app.commands.forms.page_context import Page, PageContext, new_id
from app.commands.safeguards.control import LAPSES_AFTER_S
from app.commands.service.writer import permitted
from app.errors import Problem
from app.web.access import Person, Role, Viewer
from app.web.arrival import Deadline
from bus.contract import ChangeBaud, ScanBus, UnitFigures
from bus.errors import unit_error
from bus.messages import Message
from bus.settings import BAUDS

router = APIRouter(prefix="/bus", include_in_schema=False)
SEE_OTHER = 303


@router.get("")
async def first_bus(_: Viewer, page: Page) -> Response:
    """The first of them; the page leads to the others."""
    names = list(page.live.buses)
    if not names:
        raise Problem(404, "unknown_bus", Message("no_bus_configured"))
    return RedirectResponse(f"/bus/{names[0]}", SEE_OTHER)


@router.get("/{bus}")
async def bus_page(person: Viewer, page: Page, bus: str) -> Response:
    """One bus."""
    live = page.bus(bus)
    return page.render(
        "bus/page.html",
        fields=page.fields(),
        bus=live,
        buses=list(page.live.buses),
        rows=_rows(page, bus),
        bauds=sorted(BAUDS),
        control_required=page.guards(bus).control.required,
        **_control(page, person, bus),
    )


@router.get("/{bus}/units")
async def unit_rows(_: Viewer, page: Page, bus: str) -> Response:
    """The counters of every unit, for the open page."""
    return page.render("bus/_units.html", fields=page.fields(), bus=page.bus(bus), rows=_rows(page, bus))


def _rows(page: PageContext, bus: str) -> list[dict[str, object]]:
    live = page.bus(bus)
    figures = {unit.unit: unit for unit in live.figures.units} if live.figures is not None else {}
    return [_row(page, bus, number, figures.get(number)) for number in live.units]


def _row(page: PageContext, bus: str, number: int, figures: UnitFigures | None) -> dict[str, object]:
    translator = page.translator
    naks = figures.naks if figures is not None else {}
    return {
        "unit": page.shown(bus, number),
        "figures": figures,
        "naks": ", ".join(
            f"{count} x {translator.t(unit_error(code))}" for code, count in sorted(naks.items())
        ),
        "median": _ms(page, figures.response_s_median if figures is not None else None),
        "p99": _ms(page, figures.response_s_p99 if figures is not None else None),
        "most": _ms(page, figures.response_s_max if figures is not None else None),
    }


def _ms(page: PageContext, seconds: float | None) -> str:
    return page.translator.formats.number(None if seconds is None else 1000 * seconds, 1)


@router.post("/{bus}/scan")
async def scan(
    person: Annotated[Person, permitted(SCAN_BUS)],
    page: Page,
    bus: str,
    first: Annotated[int, Form(ge=1, le=255)] = 1,
    last: Annotated[int, Form(ge=1, le=255)] = 255,
) -> Response:
    """Find the addresses that respond, in the gaps of the scan."""
    page.bus(bus)
    action = ScanBus(first=min(first, last), last=max(first, last))
    result = await page.send(person, bus, action, new_id())
    return page.render(
        "bus/_found.html",
        outcome=page.outcome(result),
        found=result.found,
        remarks=result.message,
        known=page.bus(bus).units,
        action=action,
    )


@router.get("/{bus}/control")
async def control_now(person: Viewer, page: Page, bus: str) -> Response:
    """Who holds control, for the open page."""
    return _control_part(page, person, bus)


@router.post("/{bus}/control")
async def control(
    person: Annotated[Person, TAKE_CONTROL.permitted],
    page: Page,
    bus: str,
    do: Annotated[str, Form(pattern="^(take|release|hand-over)$")],
    to: Annotated[str, Form(max_length=80)] = "",
) -> Response:
    """Take, release or hand over control of this line; names the holder where another user was quicker."""
    page.bus(bus)
    try:
        await _move_control(page, person, bus, do, to)
    except Problem as problem:
        return _control_part(page, person, bus, fault=page.translator.t(problem.message))
    return _control_part(page, person, bus)


async def _move_control(page: PageContext, person: Person, bus: str, do: str, to: str) -> None:
    match do:
        case "take":
            await page.guards(bus).take(person)
        case "release":
            await page.guards(bus).release(person)
        case _:
            if to not in _others(page, person, bus):
                raise Problem(422, "invalid", Message("new_holder_unknown"))
            await page.guards(bus).hand_over(person, to)


def _control_part(page: PageContext, person: Person, bus: str, fault: str = "") -> Response:
    context = _control(page, person, bus) | {"fault": fault}
    return page.render("bus/_control.html", bus=page.bus(bus), **context)


def _control(page: PageContext, person: Person, bus: str) -> dict[str, Any]:
    return {
        "fault": "",
        "holding": page.guards(bus).holding(),
        "others": _others(page, person, bus),
        "lapses_min": round(LAPSES_AFTER_S / 60),
    }


def _others(page: PageContext, person: Person, bus: str) -> list[str]:
    """Users with an open page who may set a line and do not hold this one."""
    holder = page.guards(bus).holder()
    here = {name for name, role in page.people().items() if Role(role).includes(TAKE_CONTROL.role)}
    if person.role.includes(FORCE_CONTROL.role):
        here.add(person.account)
    return sorted(here - {holder})


CHANGE_S = 30.0
"""Every unit written, looked for at two rates, and written back if need be."""


@router.get("/{bus}/baud")
async def review_baud(
    _: Annotated[Person, permitted(CHANGE_BAUD)], page: Page, bus: str, baud: int
) -> Response:
    """The second step; nothing has been sent."""
    live = page.bus(bus)
    if baud not in BAUDS:
        raise Problem(422, "invalid", Message.of("baud_unknown", rates=", ".join(map(str, BAUDS))))
    if baud == live.baud:
        raise Problem(422, "invalid", Message.of("baud_unchanged", baud=baud))
    return page.review("bus/_review_baud.html", bus=live, baud=baud)


@router.post("/{bus}/baud")
async def change_baud(
    person: Annotated[Person, permitted(CHANGE_BAUD)],
    page: Page,
    bus: str,
    baud: Annotated[int, Form()],
    id: Annotated[str, Form(min_length=8, max_length=200)],
) -> Response:
    """Change it at every unit; a result for each."""
    live = page.bus(bus)
    result = await page.send(person, bus, ChangeBaud(baud=baud), id, Deadline(page.made_at, CHANGE_S))
    return page.render(
        "bus/_baud_done.html", bus=live, baud=baud, outcome=page.outcome(result), result=result
    )

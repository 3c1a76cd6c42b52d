"""Many units as one change: the setpoints page."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Form
from starlette.datastructures import FormData
from starlette.requests import Request
from starlette.responses import Response

from app.commands.api.bodies import Quantity
from app.commands.api.quantity import QuantityConverter
from app.commands.catalogue import SET_LINE, longest_change_s
from app.commands.forms.line_change import followers_of, proven, reviewed
from app.commands.forms.page_context import Page, PageContext
from app.commands.forms.review import change, judge, keep_their_setpoint, know_ramps
from app.commands.review.risks import by_remark
from app.commands.rules.setpoint_range import setpoint_range
from app.commands.service.writer import permitted
from app.commands.values import measure_of_setpoint
from app.errors import Problem
from app.live.state.bus_live import BusLive, follower
from app.web.access import Person, Viewer
from bus.contract import SetLine
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message

router = APIRouter(include_in_schema=False)


@router.get("/setpoints")
async def setpoints(_: Viewer, page: Page) -> Response:
    """Every unit with its present setpoint and room for a new one."""
    buses = [
        (name, [_line_of(page, name, bus, number) for number in bus.units])
        for name, bus in page.live.buses.items()
    ]
    return page.render("setpoints/page.html", fields=page.fields(), buses=buses)


def _line_of(page: PageContext, name: str, bus: BusLive, number: int) -> dict[str, object]:
    live = bus.units[number]
    allowed = setpoint_range(live, page.guards(name).limits.of(number))
    limits = {"low": page.setpoint(allowed.lowest, live), "high": page.setpoint(allowed.highest, live)}
    return {
        "unit": page.shown(name, number),
        "measure": measure_of_setpoint(live),
        "limits": limits,
        "follower": bool(follower(live)),
    }


@router.post("/setpoints/review")
async def review_setpoints(
    request: Request, person: Annotated[Person, permitted(SET_LINE)], page: Page
) -> Response:
    """Each new setpoint that was typed, judged: old → new, limits, ramps, in one table."""
    form = await request.form()
    bus = str(form.get("bus", ""))
    live = page.bus(bus)
    try:
        setpoints = await _typed_setpoints(person, page, live, form)
        deadline = page.deadline(live, len(setpoints))
        await judge(page, person, bus, SetLine(setpoints=setpoints), deadline)
    except (CallerError, Problem) as error:
        return page.not_so(page.translator.t(error.message), f"#setpoints-error-{bus}")
    await know_ramps(page, person, bus, setpoints)
    changes = [change(page, bus, unit, raw) for unit, raw in setpoints.items()]
    left_out, unchanged = keep_their_setpoint(page, bus, setpoints)
    return page.review(
        "setpoints/_review.html",
        bus=bus,
        changes=changes,
        obstacles=by_remark((each.name, each.obstacle) for each in changes if each.obstacle),
        risks=by_remark((each.name, risk) for each in changes for risk in each.risks),
        left_out=by_remark(left_out),
        unchanged=unchanged,
        followers=followers_of(live),
        longest_s=longest_change_s(live, len(changes)),
    )


async def _typed_setpoints(
    person: Person, page: PageContext, live: BusLive, form: FormData
) -> dict[int, int]:
    """Raw setpoint by unit. Raises CallerError and Problem for an invalid setpoint."""
    fields = {unit: str(form.get(f"new-{unit}", "")).strip() for unit in live.units}
    typed = {unit: text for unit, text in fields.items() if text}
    if not typed:
        raise CallerError(Message("no_new_setpoint"))
    deadline, bus = page.deadline(live, len(typed)), live.settings.name
    setpoints = {}
    for unit, text in typed.items():
        try:
            found = QuantityConverter(page.commands(bus), person, live.units[unit], deadline)
            setpoints[unit] = await found.setpoint(Quantity(value=text))
        except CallerError as error:
            raise CallerError(
                Message.of("of_unit", name=live.units[unit].settings.name, reason=error.message)
            ) from error
    return setpoints


@router.post("/setpoints")
async def set_setpoints(
    request: Request,
    person: Annotated[Person, permitted(SET_LINE)],
    page: Page,
    bus: Annotated[str, Form()],
    id: Annotated[str, Form(max_length=64)],
    reviewed_at: Annotated[UnixTime, Form()],
) -> Response:
    """Stage all, require every acknowledgement, one broadcast, read each back: all of them or none."""
    live = page.bus(bus)
    form = await request.form()
    title = page.translator.t("Setpoints")
    try:
        page.refuse_lapsed(reviewed_at)
        setpoints = reviewed(live, form)
        result = await page.send(person, bus, SetLine(setpoints=setpoints), id)
    except Problem as problem:
        return page.refused(problem, title)
    return proven(page, bus, title, setpoints, result, form)

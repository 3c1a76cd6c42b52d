"""Many units as one change: the setpoints page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Form
from starlette.datastructures import FormData
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.access import Viewer
from app.errors import Problem
from app.line.commands.catalogue import SET_LINE, longest_change_s
from app.line.commands.forms.line_change import followers_of, left_out_of, proven, reviewed
from app.line.commands.forms.page_context import BusPage, Confirmed, Page
from app.line.commands.review import by_remark
from app.line.commands.rules import setpoint_range
from app.line.commands.service.writer import permitted
from app.line.commands.values import Scales, measure_of_setpoint, setpoint_message, setpoint_scale
from app.line.live.bus_live import follower
from bus.contract import SetLine, UnitScale
from bus.errors import CallerError
from bus.messages import Message, term

router = APIRouter(include_in_schema=False)
TITLE = term("Setpoints")


@router.get("/setpoints")
async def setpoints(_: Viewer, page: Page) -> Response:
    """Every unit with its present setpoint and room for a new one."""
    buses = [(bus.name, [_line_of(bus, number) for number in bus.bus.units]) for bus in page.buses()]
    return page.render("setpoints/page.html", fields=page.fields(), buses=buses)


def _line_of(page: BusPage, number: int) -> dict[str, object]:
    live = page.bus.units[number]
    allowed = setpoint_range(live, page.limits(number))
    low, high = setpoint_message(allowed.lowest, live), setpoint_message(allowed.highest, live)
    return {
        "unit": page.shown(number),
        "measure": measure_of_setpoint(live),
        "limits": {"low": page.translator.t(low), "high": page.translator.t(high)},
        "follower": bool(follower(live)),
    }


@router.post("/setpoints/review", dependencies=[permitted(SET_LINE)])
async def review_setpoints(request: Request, page: Page) -> Response:
    """Each new setpoint that was typed, judged: old → new, limits, ramps, in one table."""
    form = await request.form()
    of_bus = page.of_bus(str(form.get("bus", "")))
    try:
        return await review_change(of_bus, *await typed_setpoints(of_bus, form))
    except (CallerError, Problem) as error:
        return page.explain(error, f"#setpoints-error-{of_bus.name}")


async def review_change(
    of_bus: BusPage, setpoints: Mapping[int, int], typed_with: Scales | None = None
) -> Response:
    """The new setpoint of several units, raw, to be confirmed; ``typed_with``: what each was converted with,
    where they were typed. Raises Problem for what would not be sent."""
    scales = typed_with or {}
    able = {unit: raw for unit, raw in setpoints.items() if of_bus.obstacle(unit) is None}
    if able:
        await of_bus.judge(SetLine(setpoints=able), of_bus.deadline(len(able)))
    await of_bus.know_ramps(able)
    changes = [of_bus.change(unit, raw, scales.get(unit)) for unit, raw in setpoints.items()]
    able = {change.unit: change.new_raw for change in changes if change.obstacle is None}
    left_out, unchanged = of_bus.not_taking_part(setpoints)
    return of_bus.review(
        "setpoints/_review.html",
        bus=of_bus.name,
        changes=changes,
        able=len(able),
        draws=of_bus.draws(able),
        risks=by_remark((each.name, risk) for each in changes if each.unit in able for risk in each.risks),
        left_out=by_remark(left_out),
        unchanged=unchanged,
        followers=followers_of(of_bus.bus),
        longest_s=longest_change_s(of_bus.bus, len(changes)),
    )


async def typed_setpoints(page: BusPage, form: FormData) -> tuple[dict[int, int], Scales]:
    """Raw setpoint by unit, and what it was converted with. Raises CallerError and Problem for an invalid
    setpoint."""
    fields = {unit: str(form.get(f"new-{unit}", "")).strip() for unit in page.bus.units}
    typed = {unit: text for unit, text in fields.items() if text}
    if not typed:
        raise CallerError(Message("no_new_setpoint"))
    deadline = page.deadline(len(typed))
    setpoints: dict[int, int] = {}
    scales: dict[int, UnitScale] = {}
    for unit, text in typed.items():
        try:
            setpoints[unit] = await page.typed(unit, deadline).setpoint(text)
            scales[unit] = setpoint_scale(page.bus.units[unit], setpoints[unit])
        except CallerError as error:
            name = page.bus.units[unit].settings.name
            raise CallerError(Message.of("of_unit", name=name, reason=error.message)) from error
    return setpoints, scales


@router.post("/setpoints", dependencies=[permitted(SET_LINE)])
async def set_setpoints(
    request: Request, page: Page, bus: Annotated[str, Form()], confirmed: Confirmed
) -> Response:
    """Stage all, require every acknowledgement, one broadcast, read each back: all of them or none."""
    of_bus, form, title = page.of_bus(bus), await request.form(), page.translator.t(TITLE)
    try:
        is_sent = await of_bus.has_sent(confirmed.id)
        setpoints, scales = reviewed(of_bus.bus, form, is_sent=is_sent)
        if not is_sent:
            of_bus.refuse_unable(setpoints)
        result = await of_bus.carry_out(SetLine(setpoints=setpoints), confirmed, scales)
    except Problem as problem:
        return page.refused(problem, title)
    return proven(of_bus, title, setpoints, result, confirmed.id, left_out_of(form))

"""The setpoints that units hold staged: executed as one change, or discarded, from the edge of every page."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Form
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.arrival import Deadline
from app.core.web.routes import GuardedRoute
from app.errors import Problem
from app.line.commands.catalogue import EXECUTE_ALL, SET_SPEED, longest_change_s
from app.line.commands.page_context import BusPage, Confirmed, PageOfBus
from app.line.commands.pages.line import followers_of, proven, reviewed
from app.line.commands.review import by_remark, draw_changes
from app.line.commands.rules import commanded_setpoint, setpoint_parameter, staged_setpoints
from app.line.commands.service import permitted
from bus.contract import ExecuteAll, SetSpeed
from bus.messages import Message, term

router = APIRouter(prefix="/bus/{bus}/staged", include_in_schema=False, route_class=GuardedRoute)


@router.get("/review", dependencies=[permitted(EXECUTE_ALL)])
async def review_staged(page: PageOfBus) -> Response:
    """Review executing the staged setpoints of every unit of the bus."""
    try:
        staged = _known_staged(page)
        await page.judge(ExecuteAll())
        await page.know_ramps(staged)
    except Problem as problem:
        return page.refused(problem, page.translator.t(term("Staged setpoints")))
    changes = [page.change(unit, raw) for unit, raw in staged.items()]
    return page.review(
        "setpoints/_review_staged.html",
        bus=page.name,
        changes=changes,
        draws=draw_changes(page.bus, staged),
        risks=by_remark((each.name, risk) for each in changes for risk in each.risks),
        obstacles=by_remark((each.name, each.obstacle) for each in changes if each.obstacle is not None),
        followers=followers_of(page.bus),
        longest_s=longest_change_s(page.bus, len(page.bus.units)),
    )


def _known_staged(page: BusPage) -> dict[int, int]:
    """Return the staged setpoints, raw by unit. Raise Problem 409 if there is none, or one is unknown."""
    unknown = [number for number, unit in page.bus.units.items() if unit.staged_unknown]
    staged = staged_setpoints(page.bus)
    if unknown:
        raise Problem(409, "nothing_staged", Message.of("staged_unknown", unit=unknown))
    if not staged:
        raise Problem(409, "nothing_staged", Message("nothing_staged"))
    return staged


@router.post("/execute", dependencies=[permitted(EXECUTE_ALL)])
async def execute_staged(request: Request, page: PageOfBus, confirmed: Confirmed) -> Response:
    """Send 83h to every unit if the staged and the commanded values are still the reviewed ones."""
    try:
        is_sent = await page.has_sent(confirmed.id)
        setpoints, _ = reviewed(page.bus, await request.form(), is_sent=is_sent)
        if not is_sent and setpoints != _known_staged(page):
            raise Problem(409, "moved", Message("staged_moved"))
        result = await page.carry_out(ExecuteAll(), confirmed)
    except Problem as problem:
        return page.refused(problem, page.translator.t(term("Staged setpoints")))
    return proven(page, setpoints, result, confirmed.id)


async def _own_setpoint(page: BusPage, unit: int, deadline: Deadline) -> int:
    """Return the setpoint of a unit without its staged one, read from its parameter if the status shows
    another value. Raise Problem if it is not known."""
    live = page.bus.units[unit]
    number, raw = setpoint_parameter(live, page.bus), commanded_setpoint(live, page.bus)
    if number is not None:
        raw = (await page.commands.read(page.person, unit, [number], deadline))[number]
    if raw is None:
        raise Problem(409, "unknown", Message("setpoint_unknown"))
    return raw


@router.post("/discard", dependencies=[permitted(SET_SPEED)])
async def discard_staged(page: PageOfBus, id: Annotated[str, Form(max_length=64)]) -> Response:
    """Stage the present setpoint of each unit that holds another one, so that nothing is left to execute."""
    units = page.bus.units
    held = [number for number, unit in units.items() if unit.staged is not None or unit.staged_unknown]
    kept: list[tuple[str, Message]] = []
    deadline = page.deadline(len(held), typed=False)
    for unit in held:
        try:
            raw = await _own_setpoint(page, unit, deadline)
            result = await page.send(SetSpeed(unit=unit, raw=raw, execute=False), f"{id}-{unit}", deadline)
        except Problem as problem:
            kept.append((units[unit].settings.name, problem.message))
            continue
        if result.outcome != "acknowledged":
            kept.append((units[unit].settings.name, page.outcome(result, unit).text))
    response = page.render("setpoints/_discarded.html", bus=page.name, units=len(held), kept=by_remark(kept))
    if kept:
        response.headers["HX-Retarget"] = "#review-body"
    return response

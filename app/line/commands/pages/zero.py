"""Setting the line to zero from any page: one review, one confirmation, a result for every unit."""

from __future__ import annotations

import asyncio
from functools import partial

from fastapi import APIRouter
from starlette.responses import Response

from app.core.web.access import Viewer
from app.core.web.arrival import Deadline
from app.errors import Problem
from app.line.commands.catalogue import SET_LINE, longest_change_s, timeout_s_for
from app.line.commands.forms.page_context import BusPage, Confirmed, Page
from app.line.commands.review import OutcomeText, ResultRow, ZeroPlan, by_remark, plan_zero
from app.line.commands.service.writer import permitted
from app.line.commands.values import setpoint_message
from app.line.live.bus_live import BusLive
from app.line.live.fields import name_on_site
from bus.contract import Result, SetLine, SetSpeed, UnitOutcome
from bus.instants import unix_now
from bus.messages import Message, term

router = APIRouter(prefix="/line/zero", include_in_schema=False)
TITLE = term("Set line to zero")


@router.get("")
async def review_zero(person: Viewer, page: Page) -> Response:
    """What setting the line to zero will do, to which units; a bus that another user controls is one item.
    A viewer sees the same button, in the same place on every page, with the reason why it has no effect."""
    if not person.role.includes(SET_LINE.role):
        return page.render("line/_zero_not_yours.html")
    buses = page.buses()
    objections = {bus.name: bus.guards.objection(person.account) for bus in buses}
    plans = {bus: _plan(bus) for bus in buses if not objections[bus.name]}
    return page.review(
        "line/_review_zero.html",
        plans=list(plans.values()),
        risks=by_remark(
            (_on_site(bus, name), risk) for bus, plan in plans.items() for name, risk in plan.risks
        ),
        left_out=by_remark(
            (_on_site(bus, name), reason) for bus, plan in plans.items() for name, reason in plan.left_out
        ),
        held={bus: objection for bus, objection in objections.items() if objection},
        many=len(buses) > 1,
        longest_s=max((_longest_s(bus.bus, len(plan.units)) for bus, plan in plans.items()), default=0.0),
    )


def _longest_s(bus: BusLive, units: int) -> float:
    """All at once, its withdrawal, and then each alone."""
    return longest_change_s(bus, units) + units * timeout_s_for(bus)


def _plan(page: BusPage) -> ZeroPlan:
    return plan_zero(page.bus, partial(page.guards.block_reason, slows=True), unix_now())


@router.post("", dependencies=[permitted(SET_LINE)])
async def set_zero(page: Page, confirmed: Confirmed) -> Response:
    """Set the speed of every reachable unit to 0, all at once where all acknowledge, else one by one.

    A refusal by one bus or one unit does not affect the others.
    """
    title = page.translator.t(TITLE)
    try:
        confirmed.refuse_lapsed()
    except Problem as problem:
        return page.refused(problem, title)
    by_bus = await asyncio.gather(*(_zero_bus(bus, f"{confirmed.id}-{bus.name}") for bus in page.buses()))
    proofs = [proof for bus in by_bus for proof in bus]
    return page.render("line/_zero_done.html", title=title, proofs=proofs, outcome=_in_all(proofs))


async def _zero_bus(page: BusPage, id: str) -> list[ResultRow]:
    """Units that are left out come first, with the reason."""
    plan = _plan(page)
    page.commands.undo.clear(page.person)
    left_out: list[ResultRow] = [
        (_on_site(page, name), "", OutcomeText("bad", Message.of("result_left_out", reason=reason)))
        for name, reason in plan.left_out
    ]
    proofs = await _zero_units(page, plan, id) if plan.units else []
    # Nor is this: one press on Undo would start the line.
    page.commands.undo.clear(page.person)
    return left_out + proofs


async def _zero_units(page: BusPage, plan: ZeroPlan, id: str) -> list[ResultRow]:
    """Set all at once; then each unit that is not verified, unless the click itself came too late."""
    units = len(plan.units)
    together = await _sent(
        page, SetLine(setpoints=dict.fromkeys(plan.units, 0)), id, page.deadline(units, typed=False)
    )
    came_late = isinstance(together, Problem) and together.code == "not_sent"
    at_the_end = Deadline(page.made_at, _longest_s(page.bus, units))
    by_unit = {result.unit: result for result in together.units} if isinstance(together, Result) else {}
    proofs: list[ResultRow] = []
    for number, name in plan.units.items():
        result: Result | UnitOutcome | Problem = by_unit.get(number, together)
        settled = not isinstance(result, Problem) and result.outcome in ("verified", "bus_closed")
        if not settled and not came_late and at_the_end.left_s > 0:
            deadline = Deadline.within(timeout_s_for(page.bus))
            result = await _sent(page, SetSpeed(unit=number, raw=0), f"{id}-{number}", deadline)
        outcome = (
            OutcomeText("bad", result.message)
            if isinstance(result, Problem)
            else page.outcome(result, number)
        )
        proofs.append((_on_site(page, name), setpoint_message(0, page.bus.units[number]), outcome))
    return proofs


async def _sent(page: BusPage, action: SetLine | SetSpeed, id: str, deadline: Deadline) -> Result | Problem:
    """The result of a command; a rejection before the wire is a result too."""
    try:
        return await page.send(action, id, deadline)
    except Problem as problem:
        return problem


def _on_site(page: BusPage, name: str) -> str:
    return name_on_site(page.name, name, page.live.buses)


def _in_all(proofs: list[ResultRow]) -> OutcomeText:
    at_zero = sum(outcome.tone == "good" for _, _, outcome in proofs)
    if proofs and at_zero == len(proofs):
        return OutcomeText("good", Message.of("result_at_zero", n=at_zero))
    return OutcomeText("bad", Message.of("result_not_at_zero", n=len(proofs), good=at_zero))

"""Setting the line to zero from any page: one review, one confirmation, a result for every unit."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Form
from starlette.responses import Response

from app.commands.catalogue import SET_LINE, longest_change_s, timeout_s_for
from app.commands.forms.outcome import OutcomeText, ResultRow, problem_text
from app.commands.forms.page_context import Page, PageContext
from app.commands.review.risks import by_remark
from app.commands.review.zero import ZeroPlan, plan_zero
from app.commands.service.writer import permitted
from app.errors import Problem
from app.live.state.bus_live import BusLive
from app.web.access import Person, Viewer
from app.web.arrival import Deadline
from bus.contract import Result, SetLine, SetSpeed, UnitOutcome
from bus.instants import UnixTime, unix_now

router = APIRouter(prefix="/line/zero", include_in_schema=False)


@router.get("")
async def review_zero(person: Viewer, page: Page) -> Response:
    """What setting the line to zero will do, to which units; a bus that another user controls is one item.
    A viewer sees the same button, in the same place on every page, with the reason why it has no effect."""
    if not person.role.includes(SET_LINE.role):
        return page.render("line/_zero_not_yours.html")
    objections = {bus: page.guards(bus).objection(person.account) for bus in page.live.buses}
    plans = [plan for plan in _plans(page) if not objections[plan.bus]]
    return page.review(
        "line/_review_zero.html",
        plans=plans,
        risks=by_remark(
            (_on_site(page, plan.bus, name), risk) for plan in plans for name, risk in plan.risks
        ),
        left_out=by_remark(
            (_on_site(page, plan.bus, name), reason) for plan in plans for name, reason in plan.left_out
        ),
        held={bus: objection for bus, objection in objections.items() if objection},
        many=len(page.live.buses) > 1,
        longest_s=max((_longest_s(page.bus(plan.bus), len(plan.units)) for plan in plans), default=0.0),
    )


def _longest_s(bus: BusLive, units: int) -> float:
    """All at once, its withdrawal, and then each alone."""
    return longest_change_s(bus, units) + units * timeout_s_for(bus)


def _plans(page: PageContext) -> list[ZeroPlan]:
    now = unix_now()
    return [plan_zero(bus, page.guards(name).block_reason, now) for name, bus in page.live.buses.items()]


@router.post("")
async def set_zero(
    person: Annotated[Person, permitted(SET_LINE)],
    page: Page,
    id: Annotated[str, Form(max_length=64)],
    reviewed_at: Annotated[UnixTime, Form()],
) -> Response:
    """Set the speed of every reachable unit to 0, all at once where all acknowledge, else one by one.

    A refusal by one bus or one unit does not affect the others.
    """
    title = page.translator.t("Set line to zero")
    try:
        page.refuse_lapsed(reviewed_at)
    except Problem as problem:
        return page.refused(problem, title)
    by_bus = await asyncio.gather(*(_zero_bus(person, page, plan, id) for plan in _plans(page)))
    proofs = [proof for bus in by_bus for proof in bus]
    return page.render("line/_zero_done.html", title=title, proofs=proofs, outcome=_in_all(page, proofs))


async def _zero_bus(person: Person, page: PageContext, plan: ZeroPlan, id: str) -> list[ResultRow]:
    """Units that are left out come first, with the reason."""
    left_out = [
        (
            _on_site(page, plan.bus, name),
            "",
            OutcomeText("bad", f"{page.translator.t('left out')}: {page.translator.t(reason)}"),
        )
        for name, reason in plan.left_out
    ]
    return left_out + (await _zero_units(person, page, plan, id) if plan.units else [])


async def _zero_units(person: Person, page: PageContext, plan: ZeroPlan, id: str) -> list[ResultRow]:
    """Set all at once; then each unit that is not verified, unless the click itself came too late."""
    action, bus_commands = (
        SetLine(setpoints=dict.fromkeys(plan.units, 0)),
        _BusCommands(person, page, plan.bus, id),
    )
    live, units = page.bus(plan.bus), len(plan.units)
    together = await bus_commands(action, "", page.deadline(live, units))
    came_late = isinstance(together, Problem) and together.code == "not_sent"
    at_the_end = Deadline(page.made_at, _longest_s(live, units))
    by_unit = {result.unit: result for result in together.units} if isinstance(together, Result) else {}
    proofs = []
    for number, name in plan.units.items():
        result: Result | UnitOutcome | Problem = by_unit.get(number, together)
        settled = not isinstance(result, Problem) and result.outcome in ("verified", "bus_closed")
        if not settled and not came_late and at_the_end.left_s > 0:
            deadline = Deadline.within(timeout_s_for(live))
            result = await bus_commands(SetSpeed(unit=number, raw=0), f"-{number}", deadline)
        unit = page.unit(plan.bus, number)
        shown = (
            problem_text(result, page.translator)
            if isinstance(result, Problem)
            else page.outcome(result, unit)
        )
        proofs.append((_on_site(page, plan.bus, name), page.setpoint(0, unit), shown))
    return proofs


class _BusCommands:
    """Sends commands to one bus for one confirmation; a rejection before the wire is a result too."""

    def __init__(self, person: Person, page: PageContext, bus: str, id: str) -> None:
        self._person, self._page, self._bus, self._id = person, page, bus, f"{id}-{bus}"

    async def __call__(self, action: SetLine | SetSpeed, part: str, deadline: Deadline) -> Result | Problem:
        try:
            return await self._page.send(self._person, self._bus, action, self._id + part, deadline)
        except Problem as problem:
            return problem


def _on_site(page: PageContext, bus: str, name: str) -> str:
    """Two buses may each have a unit of that name."""
    return f"{bus} · {name}" if len(page.live.buses) > 1 else name


def _in_all(page: PageContext, proofs: list[ResultRow]) -> OutcomeText:
    at_zero = sum(outcome.tone == "good" for _, _, outcome in proofs)
    if proofs and at_zero == len(proofs):
        good = page.translator.tn(
            "{n} unit accepted speed 0 and ramps down", "{n} units accepted speed 0 and ramp down", at_zero
        )
        return OutcomeText("good", good)
    bad = page.translator.tn(
        "the unit did not accept speed 0: check it",
        "{good} of {n} units accepted speed 0: check the others",
        len(proofs),
        good=at_zero,
    )
    return OutcomeText("bad", bad)

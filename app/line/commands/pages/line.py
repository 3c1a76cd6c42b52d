"""Several units as one change: the setpoints page; setting the line to zero, and executing or discarding the
setpoints that units hold staged, from any page.

The form of a review of several units holds for each unit ``raw-N``, the new setpoint, ``was-N``, the one that
the person saw, both raw, the latter empty if it was not known, and ``scale-N``, the scale in which both were
shown. ``leave-out`` are the units that the person leaves out by name, because they cannot take it now.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterable, Mapping
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Form
from starlette.datastructures import FormData
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.access import Viewer
from app.core.web.arrival import Deadline
from app.core.web.routes import GuardedRoute
from app.core.web.shape import parse_integer
from app.errors import Problem
from app.line.commands.catalogue import EXECUTE_ALL, SET_LINE, SET_SPEED, longest_change_s, timeout_s_for
from app.line.commands.page_context import BusPage, Confirmed, Page, PageOfBus
from app.line.commands.review import (
    OutcomeText,
    ResultRow,
    ZeroPlan,
    by_remark,
    draw_changes,
    draw_seam,
    failed_units,
    obstacle_of,
    outcome_of_all,
    plan_zero,
    present_setpoint,
)
from app.line.commands.rules import commanded_setpoint, setpoint_parameter, setpoint_range, staged_setpoints
from app.line.commands.service import permitted
from app.line.commands.values import Scales, measure_of_setpoint, parse_scale, setpoint_message
from app.line.conditions.condition import follower
from app.line.live.bus_live import BusLive, held_units
from app.line.live.fields import name_on_site
from bus.contract import ExecuteAll, Result, SetLine, SetSpeed, UnitOutcome, UnitScale
from bus.errors import CallerError
from bus.instants import unix_now
from bus.messages import Message, joined, term

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)


@router.get("/setpoints")
async def setpoints(_: Viewer, page: Page) -> Response:
    """Show every unit with its present setpoint and a field for a new one."""
    buses = [(bus.name, [_line_of(bus, number) for number in bus.bus.units]) for bus in page.buses()]
    return page.render("setpoints/page.html", fields=page.fields(), buses=buses)


def _line_of(page: BusPage, number: int) -> dict[str, object]:
    live = page.bus.units[number]
    allowed = setpoint_range(live, page.guards.limits(number))
    low, high = setpoint_message(allowed.lowest, live), setpoint_message(allowed.highest, live)
    return {
        "unit": page.shown(number),
        "measure": measure_of_setpoint(live),
        "limits": {"low": page.translator.t(low), "high": page.translator.t(high)},
        "follower": bool(follower(live)),
        "draw": draw_seam(page.bus, number),
    }


@router.post("/setpoints/review", dependencies=[permitted(SET_LINE)])
async def review_setpoints(request: Request, page: Page) -> Response:
    """Review each setpoint that was typed: old → new, limits, ramps, in one table."""
    form = await request.form()
    of_bus = page.of_bus(str(form.get("bus", "")))
    try:
        return await review_change(of_bus, *await typed_setpoints(of_bus, form))
    except (CallerError, Problem) as error:
        return of_bus.explain_setpoint(error)


async def review_change(
    of_bus: BusPage, setpoints: Mapping[int, int], typed_with: Scales | None = None
) -> Response:
    """Review the new setpoints, raw, of several units; ``typed_with``: their scales, if they were typed.
    Raise Problem if they would not be sent."""
    scales = typed_with or {}
    able = {unit: raw for unit, raw in setpoints.items() if of_bus.obstacle(unit) is None}
    if able:
        await of_bus.judge(SetLine(setpoints=able), of_bus.deadline(len(able)))
        refuse_outsiders(of_bus, able)
    await of_bus.know_ramps(able)
    changes = [of_bus.change(unit, raw, scales.get(unit)) for unit, raw in setpoints.items()]
    able = {change.unit: change.new_raw for change in changes if change.obstacle is None}
    left_out, unchanged = of_bus.not_taking_part(setpoints)
    return of_bus.review(
        "setpoints/_review.html",
        bus=of_bus.name,
        changes=changes,
        able=len(able),
        draws=draw_changes(of_bus.bus, able),
        risks=by_remark((each.name, risk) for each in changes if each.unit in able for risk in each.risks),
        left_out=by_remark(left_out),
        unchanged=unchanged,
        followers=followers_of(of_bus.bus),
        longest_s=longest_change_s(of_bus.bus, len(changes)),
    )


def refuse_outsiders(page: BusPage, units: Collection[int]) -> None:
    """Raise Problem 409 if a unit outside a change of ``units`` may hold a staged setpoint, which the
    broadcast executes too, and cannot be given its present one instead."""
    for unit in held_units(page.bus):
        if unit not in units and obstacle_of(page.bus, page.bus.units[unit], unix_now()) is not None:
            raise Problem(409, "not_loadable", page.would_move(unit))


async def typed_setpoints(page: BusPage, form: FormData) -> tuple[dict[int, int], Scales]:
    """Return the raw setpoints in a form by unit, and their scales. Raise CallerError and Problem for an
    invalid setpoint."""
    fields = {unit: str(form.get(f"new-{unit}", "")).strip() for unit in page.bus.units}
    typed = {unit: text for unit, text in fields.items() if text}
    if not typed:
        raise CallerError(Message("no_new_setpoint"))
    deadline = page.deadline(len(typed))
    setpoints: dict[int, int] = {}
    scales: dict[int, UnitScale] = {}
    for unit, text in typed.items():
        try:
            setpoints[unit], scales[unit] = await page.typed_setpoint(unit, text, deadline)
        except CallerError as error:
            reason = Message.of("of_unit", name=page.bus.units[unit].settings.name, reason=error.message)
            raise Problem(422, "invalid", reason, unit=unit) from error
    return setpoints, scales


@router.post("/setpoints", dependencies=[permitted(SET_LINE)])
async def set_setpoints(
    request: Request, page: Page, bus: Annotated[str, Form()], confirmed: Confirmed
) -> Response:
    """Stage all, require every acknowledgement, broadcast once, read each back: all change or none."""
    of_bus, form = page.of_bus(bus), await request.form()
    try:
        is_sent = await of_bus.has_sent(confirmed.id)
        setpoints, scales = reviewed(of_bus.bus, form, is_sent=is_sent)
        if not is_sent:
            _refuse_unable(of_bus, setpoints)
        result = await of_bus.carry_out(SetLine(setpoints=setpoints), confirmed, scales)
    except Problem as problem:
        return of_bus.not_sent(problem)
    return proven(of_bus, setpoints, result, confirmed.id, left_out_of(form))


def _refuse_unable(page: BusPage, units: Iterable[int]) -> None:
    """Raise Problem 409 if one of these units takes no command now: all of a change, or none. A block is left
    to the command, whose refusal is recorded."""
    for unit in units:
        if (reason := obstacle_of(page.bus, page.bus.units[unit], unix_now())) is not None:
            unable = Message.of("unit_unable", name=page.name_of(unit), reason=reason)
            raise Problem(409, "not_loadable", unable)


def left_out_of(form: FormData) -> set[int]:
    """Return the units that the person leaves out. Raise Problem 422 for anything but addresses."""
    units = {parse_integer(str(text)) for text in form.getlist("leave-out")}
    if None in units:
        raise Problem(422, "invalid", Message("not_what_was_reviewed"))
    return {unit for unit in units if unit is not None}


def reviewed(live: BusLive, form: FormData, *, is_sent: bool) -> tuple[dict[int, int], Scales]:
    """Return the reviewed setpoints, raw, of the units that are not left out, and their scales. Raise
    Problem 409 if one has moved since the review, unless ``is_sent``: then this change itself may have moved
    it."""
    setpoints, scales, left_out = {}, {}, left_out_of(form)
    for number, unit in live.units.items():
        text = str(form.get(f"raw-{number}", ""))
        if not text or number in left_out:
            continue
        raw = parse_integer(text, 6)
        if raw is None:
            raise Problem(422, "invalid", Message("not_what_was_reviewed"))
        present = present_setpoint(live, unit)
        was = str(form.get(f"was-{number}", ""))
        if not is_sent and was != ("" if present is None else str(present)):
            raise Problem(409, "moved", Message.of("setpoint_of_moved", name=unit.settings.name))
        setpoints[number], scales[number] = raw, parse_scale(form.get(f"scale-{number}"))
    return setpoints, scales


def followers_of(live: BusLive) -> set[int]:
    """Return the units whose setpoint is a ratio, for which the screen has no live value."""
    return {number for number, unit in live.units.items() if follower(unit)}


def proven(
    page: BusPage, setpoints: Mapping[int, int], result: Result, id: str, left_out: Collection[int] = ()
) -> Response:
    """Render the outcome of each unit in floor order, then the units that were left out, and the undo of the
    change with this id."""
    result = page.in_words(result)
    by_unit, units = {outcome.unit: outcome for outcome in result.units}, page.bus.units
    rows = {number: page.outcome(by_unit.get(number, result), number) for number in setpoints}
    proofs: list[tuple[str | Message, str | Message, OutcomeText]] = [
        (units[number].settings.name, setpoint_message(setpoints[number], units[number]), words)
        for number, words in rows.items()
    ]
    proofs += [(page.name_of(unit), "", page.outcome_left_out(unit)) for unit in sorted(left_out)]
    # A broadcast is followed by a read of every unit: of one outside the change only a speed that has moved
    # counts, and not that it does not respond.
    others = by_unit.keys() - setpoints.keys() - set(left_out)
    rows |= {
        unit: page.outcome(by_unit[unit], unit)
        for unit in sorted(others)
        if by_unit[unit].outcome != "verified" and by_unit[unit].read_back is not None
    }
    named = {unit: (units[unit].settings.name, words) for unit, words in rows.items()}
    together = [each for each in result.units if each.unit in setpoints and each.message is None]
    return page.render(
        "setpoints/_done.html",
        outcome=outcome_of_all(result, named, len(setpoints)),
        proofs=proofs,
        undo=page.undo(id),
        together=sum(each.outcome == "verified" for each in together),
        skew=None if result.skew_s is None else page.translator.formats.number(result.skew_s * 1000),
    )


ZERO_TITLE, LINES_TITLE = term("Set line to zero"), term("Set lines to zero")


@router.get("/line/zero")
async def review_zero(person: Viewer, page: Page, bus: str | None = None) -> Response:
    """Render the review of *Set line to zero*: the units that change, those that do not, and the lines that
    another user controls. ``bus``: the only line that is set; None: the user chooses among all. A viewer
    gets the reason why the button has no effect."""
    if not person.role.includes(SET_LINE.role):
        return page.render("line/_zero_not_yours.html")
    buses = page.buses() if bus is None else [page.of_bus(bus)]
    objections = {each.name: each.guards.objection(person.account) for each in buses}
    plans = {each: _plan(each) for each in buses if not objections[each.name]}
    return page.review(
        "line/_review_zero.html",
        plans=list(plans.values()),
        risks={plan.bus: by_remark(plan.risks) for plan in plans.values()},
        left_out={plan.bus: by_remark(plan.left_out) for plan in plans.values()},
        held={bus: objection for bus, objection in objections.items() if objection},
        asked=bus,
        units_shown=[f"{each.name}/{unit}" for each in plans for unit in each.bus.units],
        others=[name for name in page.live.buses if name not in objections],
        many=len(page.live.buses) > 1,
        longest_s=max((_longest_s(each.bus, len(plan.units)) for each, plan in plans.items()), default=0.0),
    )


def _longest_s(bus: BusLive, units: int) -> float:
    """Return the most seconds of a change: all at once, its withdrawal, and then each alone."""
    return longest_change_s(bus, units) + units * timeout_s_for(bus)


def _plan(page: BusPage) -> ZeroPlan:
    return plan_zero(page.bus, partial(page.guards.block_reason, slows=True), unix_now())


@router.post("/line/zero", dependencies=[permitted(SET_LINE)])
async def set_zero(
    page: Page, confirmed: Confirmed, bus: Annotated[tuple[str, ...], Form()] = ()
) -> Response:
    """Set the speed of every reachable unit of each ``bus`` to 0, all at once if all acknowledge, else one by
    one. A refusal by one bus or one unit does not affect the others. The only bus need not be named."""
    buses = [page.of_bus(name) for name in dict.fromkeys(bus)] or page.buses()
    if not bus and len(buses) > 1:
        raise Problem(422, "invalid", Message("not_what_was_reviewed"))
    try:
        confirmed.refuse_lapsed()
    except Problem as problem:
        title = ZERO_TITLE if len(buses) == 1 else LINES_TITLE
        response = page.refused(problem, page.translator.t(title))
        response.headers["HX-Retarget"] = "#review-body"
        return response
    by_bus = await asyncio.gather(*(_zero_bus(each, f"{confirmed.id}-{each.name}") for each in buses))
    proofs = [proof for rows in by_bus for proof in rows]
    return page.render(
        "setpoints/_done.html",
        proofs=proofs,
        outcome=_in_all(proofs),
        what=_lines_set(zip(buses, by_bus, strict=True)) if len(page.live.buses) > 1 < len(proofs) else "",
        undo=None,
        skew=None,
    )


def _lines_set(results: Iterable[tuple[BusPage, list[ResultRow]]]) -> str:
    set_now = (page.name for page, rows in results if any(outcome.tone == "good" for *_, outcome in rows))
    return ", ".join(set_now)


async def _zero_bus(page: BusPage, id: str) -> list[ResultRow]:
    """Set a bus to zero. Units that are left out come first in the result, with the reason."""
    plan = _plan(page)
    page.commands.undo.clear(page.person)
    left_out: list[ResultRow] = [
        (_on_site(page, name), "", OutcomeText("bad", Message.of("result_left_out", reason=reason)))
        for name, reason in plan.left_out
    ]
    proofs = await _zero_units(page, plan, id) if plan.units else []
    # Cleared again, because this is no command to undo either: one press on Undo would start the line.
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
    """Send a command and return its result; a rejection before the wire is a result too."""
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
    not_all = Message.of("result_not_at_zero", n=len(proofs), good=at_zero)
    failed = failed_units((name, outcome) for name, _, outcome in proofs)
    return OutcomeText("bad", joined((not_all, *failed)) or not_all)


staged_router = APIRouter(prefix="/bus/{bus}/staged", include_in_schema=False, route_class=GuardedRoute)


@staged_router.get("/review", dependencies=[permitted(EXECUTE_ALL)])
async def review_staged(page: PageOfBus) -> Response:
    """Review executing the staged setpoints of every unit of the bus."""
    try:
        staged = _known_staged(page)
        await page.judge(ExecuteAll())
        await page.know_ramps(staged)
    except Problem as problem:
        return page.refused(problem, page.translator.t(term("Staged setpoints")))
    able = _able(page, staged)
    changes = [page.change(unit, raw) for unit, raw in able.items()]
    return page.review(
        "setpoints/_review_staged.html",
        bus=page.name,
        changes=changes,
        draws=draw_changes(page.bus, able),
        risks=by_remark((each.name, risk) for each in changes for risk in each.risks),
        unable=by_remark(
            (page.bus.units[unit].settings.name, reason)
            for unit in staged
            if (reason := page.obstacle(unit)) is not None
        ),
        followers=followers_of(page.bus),
        longest_s=longest_change_s(page.bus, len(page.bus.units)),
    )


def _able(page: BusPage, staged: Mapping[int, int]) -> dict[int, int]:
    """Return the staged setpoints that a broadcast executes now: the other units keep theirs."""
    return {unit: raw for unit, raw in staged.items() if page.obstacle(unit) is None}


def _known_staged(page: BusPage) -> dict[int, int]:
    """Return the staged setpoints, raw by unit. Raise Problem 409 if there is none, or one is unknown."""
    unknown = [unit.settings.name for unit in page.bus.units.values() if unit.staged_unknown]
    staged = staged_setpoints(page.bus)
    if unknown:
        raise Problem(409, "nothing_staged", Message.of("staged_lost", names=unknown))
    if not staged:
        raise Problem(409, "nothing_staged", Message("nothing_staged"))
    return staged


@staged_router.post("/execute", dependencies=[permitted(EXECUTE_ALL)])
async def execute_staged(request: Request, page: PageOfBus, confirmed: Confirmed) -> Response:
    """Send 83h to every unit if what it executes, and the commanded values, are still as reviewed."""
    try:
        is_sent = await page.has_sent(confirmed.id)
        setpoints, _ = reviewed(page.bus, await request.form(), is_sent=is_sent)
        if not is_sent:
            _refuse_unable(page, setpoints)
            if setpoints != _able(page, _known_staged(page)):
                raise Problem(409, "moved", Message("staged_moved"))
        result = await page.carry_out(ExecuteAll(), confirmed)
    except Problem as problem:
        response = page.refused(problem, page.translator.t(term("Staged setpoints")))
        response.headers["HX-Retarget"] = "#review-body"
        return response
    return proven(page, setpoints, result, confirmed.id, staged_setpoints(page.bus).keys() - setpoints.keys())


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


@staged_router.post("/discard", dependencies=[permitted(SET_SPEED)])
async def discard_staged(page: PageOfBus, id: Annotated[str, Form(max_length=64)]) -> Response:
    """Stage the present setpoint of each unit that holds another one, so that nothing is left to execute."""
    units = page.bus.units
    held = held_units(page.bus)
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

"""A unit's setpoint on its page: choose, then review, then do.

Nothing is sent before the review is confirmed, but for a nudge that is small enough to need none.
"""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Form
from starlette.responses import Response

from app.commands.api.bodies import Quantity
from app.commands.api.quantity import QuantityConverter
from app.commands.catalogue import EXECUTE_SPEED, SET_SPEED
from app.commands.forms.page_context import Page, PageContext
from app.commands.forms.review import change, judge, know_ramps
from app.commands.review.ramp import nudges, present_setpoint
from app.commands.service.writer import permitted, permitted_writer
from app.errors import Problem
from app.live.state.bus_live import UnitLive, follower
from app.web.access import Person
from bus.contract import ExecuteSpeed, Result, SetSpeed
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message

router = APIRouter(prefix="/units/{bus}/{unit:int}", include_in_schema=False)

SetpointField = Annotated[int, Form(ge=0)]
Was = Annotated[str, Form(pattern=r"^\d{0,6}$")]
"""The setpoint that the person saw, raw; empty where it was not known."""
ERROR_PLACE = "#setpoint-error"


@router.post("/review")
async def review_speed(
    person: Annotated[Person, permitted(SET_SPEED)],
    page: Page,
    bus: str,
    unit: int,
    value: Annotated[str, Form(max_length=20)] = "",
    how: Annotated[Literal["now", "stage"], Form()] = "now",
) -> Response:
    """What was typed, judged and shown again: old → new, limits, ramp."""
    live = page.unit(bus, unit)
    try:
        typed = QuantityConverter(page.commands(bus), person, live, page.deadline(page.bus(bus)))
        raw = await typed.setpoint(Quantity(value=value))
        return await _review(person, page, bus, live, raw, execute=how == "now")
    except (CallerError, Problem) as error:
        return _not_so(page, live, error)


async def _review(
    person: Person, page: PageContext, bus: str, live: UnitLive, raw: int, *, execute: bool
) -> Response:
    unit = live.settings.id
    await judge(page, person, bus, SetSpeed(unit=unit, raw=raw, execute=execute))
    await know_ramps(page, person, bus, [unit])
    return page.review(
        "unit/_review_speed.html",
        unit=page.shown(bus, unit),
        change=change(page, bus, unit, raw),
        execute=execute,
        follower=bool(follower(live)),
    )


def _not_so(page: PageContext, live: UnitLive, error: CallerError | Problem) -> Response:
    nearest = error.extra.get("nearest") if isinstance(error, Problem) else None
    return page.not_so(
        page.translator.t(error.message),
        ERROR_PLACE,
        nearest=page.setpoint(nearest, live),
        status=error.status if isinstance(error, Problem) else 422,
    )


@router.post("/speed")
async def set_speed(
    person: Annotated[Person, permitted_writer(SET_SPEED)],
    page: Page,
    bus: str,
    unit: int,
    raw: SetpointField,
    id: Annotated[str, Form(max_length=64)],
    how: Annotated[Literal["now", "stage"], Form()],
    reviewed_at: Annotated[UnixTime, Form()],
    was: Was = "",
) -> Response:
    """Send the reviewed setpoint, once, and show its result."""
    live = page.unit(bus, unit)
    action = SetSpeed(unit=unit, raw=raw, execute=how == "now")
    try:
        page.refuse_lapsed(reviewed_at)
        _refuse_moved(page, bus, live, was)
        result = await page.send(person, bus, action, id)
    except Problem as problem:
        return page.refused(problem, live.settings.name)
    return _done(page, bus, live, raw, result, was if action.execute else "")


def _done(page: PageContext, bus: str, live: UnitLive, raw: int, result: Result, was: str) -> Response:
    """The result; ``was``: what undo offers once the new setpoint is verified, empty where it offers none."""
    # The screen has the commanded speed of a follower, and no ratio to compare with.
    reads = "" if follower(live) else f"{bus}/{live.settings.id}.commanded"
    return page.done(
        live.settings.name,
        page.outcome(result, live),
        requested=page.setpoint(raw, live),
        reads=reads,
        undo=page.setpoint(int(was), live) if was and result.outcome == "verified" else "",
        unit=page.shown(bus, live.settings.id),
    )


def _refuse_moved(page: PageContext, bus: str, live: UnitLive, was: str) -> None:
    present = present_setpoint(page.bus(bus), live)
    if was != ("" if present is None else str(present)):
        raise Problem(409, "moved", Message("setpoint_moved"))


@router.post("/nudge")
async def nudge(
    person: Annotated[Person, permitted_writer(SET_SPEED)],
    page: Page,
    bus: str,
    unit: int,
    step: Annotated[int, Form(ge=-99999, le=99999)],
    id: Annotated[str, Form(max_length=64)],
) -> Response:
    """A small step from where the unit is now: without a review where it is no larger than one allowed so."""
    live = page.unit(bus, unit)
    present = present_setpoint(page.bus(bus), live)
    try:
        if present is None:
            raise Problem(409, "unknown", Message("setpoint_unknown"))
        raw = present + step
        if raw < 0:
            raise Problem(422, "invalid", Message("step_below_zero"), nearest=0)
        if not _is_small(page, bus, live, step):
            return await _review(person, page, bus, live, raw, execute=True)
        result = await page.send(person, bus, SetSpeed(unit=unit, raw=raw), id)
    except Problem as problem:
        return _not_so(page, live, problem)
    response = page.render(
        "unit/_nudged.html", requested=page.setpoint(raw, live), outcome=page.outcome(result, live)
    )
    response.headers["HX-Retarget"] = ERROR_PLACE
    return response


def _is_small(page: PageContext, bus: str, live: UnitLive, step: int) -> bool:
    allowed = page.guards(bus).limits.of(live.settings.id).largest_step
    return abs(step) <= (max(nudges(live)) if allowed is None else allowed)


@router.get("/execute")
async def review_execute(
    person: Annotated[Person, permitted(EXECUTE_SPEED)], page: Page, bus: str, unit: int
) -> Response:
    """What executing the staged speed will do."""
    live = page.unit(bus, unit)
    try:
        staged = live.staged
        if staged is None:
            raise Problem(409, "nothing_staged", Message("nothing_staged"))
        await judge(page, person, bus, ExecuteSpeed(unit=unit))
        await know_ramps(page, person, bus, [unit])
    except Problem as problem:
        return page.refused(problem, live.settings.name)
    return page.review(
        "unit/_review_execute.html",
        unit=page.shown(bus, unit),
        change=change(page, bus, unit, staged),
    )


@router.post("/execute")
async def execute(
    person: Annotated[Person, permitted_writer(EXECUTE_SPEED)],
    page: Page,
    bus: str,
    unit: int,
    id: Annotated[str, Form(max_length=64)],
    raw: SetpointField,
    reviewed_at: Annotated[UnixTime, Form()],
    was: Was = "",
) -> Response:
    """Send 83h to one unit if its staged and its commanded value are still the reviewed ones."""
    live = page.unit(bus, unit)
    try:
        page.refuse_lapsed(reviewed_at)
        if live.staged != raw:
            raise Problem(409, "moved", Message("staged_moved"))
        _refuse_moved(page, bus, live, was)
        result = await page.send(person, bus, ExecuteSpeed(unit=unit), id)
    except Problem as problem:
        return page.refused(problem, live.settings.name)
    return _done(page, bus, live, raw, result, was)

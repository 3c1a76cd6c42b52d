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
from app.commands.values import shown_setpoint
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
    desk: Page,
    bus: str,
    unit: int,
    value: Annotated[str, Form(max_length=20)] = "",
    how: Annotated[Literal["now", "stage"], Form()] = "now",
) -> Response:
    """What was typed, judged and shown again: old → new, limits, ramp."""
    live = desk.unit(bus, unit)
    try:
        typed = QuantityConverter(desk.commands(bus), person, live, desk.deadline(desk.bus(bus)))
        raw = await typed.setpoint(Quantity(value=value))
        return await _review(person, desk, bus, live, raw, execute=how == "now")
    except (CallerError, Problem) as error:
        return _not_so(desk, live, error)


async def _review(
    person: Person, desk: PageContext, bus: str, live: UnitLive, raw: int, *, execute: bool
) -> Response:
    unit = live.settings.id
    await judge(desk, person, bus, SetSpeed(unit=unit, raw=raw, execute=execute))
    await know_ramps(desk, person, bus, [unit])
    return desk.review(
        "unit/_review_speed.html",
        unit=desk.shown(bus, unit),
        change=change(desk, bus, unit, raw),
        execute=execute,
        follower=bool(follower(live)),
    )


def _not_so(desk: PageContext, live: UnitLive, error: CallerError | Problem) -> Response:
    nearest = error.extra.get("nearest") if isinstance(error, Problem) else None
    return desk.not_so(
        desk.voice.t(error.message),
        ERROR_PLACE,
        nearest="" if nearest is None else desk.voice.formats.point(shown_setpoint(nearest, live)),
        status=error.status if isinstance(error, Problem) else 422,
    )


@router.post("/speed")
async def set_speed(
    person: Annotated[Person, permitted_writer(SET_SPEED)],
    desk: Page,
    bus: str,
    unit: int,
    raw: SetpointField,
    id: Annotated[str, Form(max_length=64)],
    how: Annotated[Literal["now", "stage"], Form()],
    reviewed_at: Annotated[UnixTime, Form()],
    was: Was = "",
) -> Response:
    """The reviewed setpoint, once, to its fate."""
    live = desk.unit(bus, unit)
    action = SetSpeed(unit=unit, raw=raw, execute=how == "now")
    try:
        desk.refuse_lapsed(reviewed_at)
        _refuse_moved(desk, bus, live, was)
        result = await desk.ask(person, bus, action, id)
    except Problem as problem:
        return desk.refused(problem, live.settings.name)
    undo = {"value": shown_setpoint(int(was), live), "how": how} if was and action.execute else None
    return _done(desk, bus, live, raw, result, undo if result.outcome == "verified" else None)


def _done(
    desk: PageContext, bus: str, live: UnitLive, raw: int, result: Result, undo: dict[str, str] | None
) -> Response:
    # The screen says the commanded speed of a follower, and no ratio to prove this by.
    reads = "" if follower(live) else f"{bus}/{live.settings.id}.commanded"
    return desk.done(
        live.settings.name,
        desk.outcome(result, live),
        asked=shown_setpoint(raw, live),
        reads=reads,
        undo=undo,
        unit=desk.shown(bus, live.settings.id),
    )


def _refuse_moved(desk: PageContext, bus: str, live: UnitLive, was: str) -> None:
    present = present_setpoint(desk.bus(bus), live)
    if was != ("" if present is None else str(present)):
        raise Problem(409, "moved", Message("setpoint_moved"))


@router.post("/nudge")
async def nudge(
    person: Annotated[Person, permitted_writer(SET_SPEED)],
    desk: Page,
    bus: str,
    unit: int,
    step: Annotated[int, Form(ge=-99999, le=99999)],
    id: Annotated[str, Form(max_length=64)],
) -> Response:
    """A small step from where the unit is now: without a review where it is no larger than one allowed so."""
    live = desk.unit(bus, unit)
    present = present_setpoint(desk.bus(bus), live)
    try:
        if present is None:
            raise Problem(409, "unknown", Message("setpoint_unknown"))
        raw = present + step
        if raw < 0:
            raise Problem(422, "invalid", Message("step_below_zero"), nearest=0)
        if not _is_small(desk, bus, live, step):
            return await _review(person, desk, bus, live, raw, execute=True)
        result = await desk.ask(person, bus, SetSpeed(unit=unit, raw=raw), id)
    except Problem as problem:
        return _not_so(desk, live, problem)
    response = desk.render(
        "unit/_nudged.html", asked=shown_setpoint(raw, live), outcome=desk.outcome(result, live)
    )
    response.headers["HX-Retarget"] = ERROR_PLACE
    return response


def _is_small(desk: PageContext, bus: str, live: UnitLive, step: int) -> bool:
    allowed = desk.guards(bus).limits.of(live.settings.id).largest_step
    return abs(step) <= (max(nudges(live)) if allowed is None else allowed)


@router.get("/execute")
async def review_execute(
    person: Annotated[Person, permitted(EXECUTE_SPEED)], desk: Page, bus: str, unit: int
) -> Response:
    """What executing the staged speed will do."""
    live = desk.unit(bus, unit)
    try:
        staged = live.staged
        if staged is None:
            raise Problem(409, "nothing_staged", Message("nothing_staged"))
        await judge(desk, person, bus, ExecuteSpeed(unit=unit))
        await know_ramps(desk, person, bus, [unit])
    except Problem as problem:
        return desk.refused(problem, live.settings.name)
    return desk.review(
        "unit/_review_execute.html",
        unit=desk.shown(bus, unit),
        change=change(desk, bus, unit, staged),
    )


@router.post("/execute")
async def execute(
    person: Annotated[Person, permitted_writer(EXECUTE_SPEED)],
    desk: Page,
    bus: str,
    unit: int,
    id: Annotated[str, Form(max_length=64)],
    raw: SetpointField,
    reviewed_at: Annotated[UnixTime, Form()],
) -> Response:
    """83h to one unit, if what is staged is still what was reviewed."""
    live = desk.unit(bus, unit)
    try:
        desk.refuse_lapsed(reviewed_at)
        if live.staged != raw:
            raise Problem(409, "moved", Message("staged_moved"))
        result = await desk.ask(person, bus, ExecuteSpeed(unit=unit), id)
    except Problem as problem:
        return desk.refused(problem, live.settings.name)
    return _done(desk, bus, live, raw, result, undo=None)

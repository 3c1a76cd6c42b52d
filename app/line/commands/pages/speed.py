"""A unit's setpoint on its page: choose, then review, then confirm.

Nothing is sent before the review is confirmed, except a nudge that is small enough to need none.
"""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Form
from starlette.responses import Response

from app.core.web.routes import GuardedRoute
from app.errors import Problem
from app.line.commands.catalogue import EXECUTE_SPEED, SET_SPEED
from app.line.commands.page_context import Confirmed, PageOfUnit, ReviewedScale, UnitPage
from app.line.commands.review import draw_changes, is_held, leaves_band, nudges
from app.line.commands.service import permitted, permitted_writer
from app.line.conditions.condition import follower
from bus.contract import ExecuteSpeed, Result, SetSpeed, UnitScale
from bus.errors import CallerError
from bus.messages import Message

router = APIRouter(prefix="/units/{bus}/{unit:int}", include_in_schema=False, route_class=GuardedRoute)

SetpointField = Annotated[int, Form(ge=0)]
SeenSetpoint = Annotated[str, Form(pattern=r"^\d{0,6}$")]
"""The setpoint that the person saw, raw; empty if it was not known."""
ERROR_PLACE = "#setpoint-error"


@router.post("/review", dependencies=[permitted(SET_SPEED)])
async def review_speed(
    page: PageOfUnit,
    value: Annotated[str, Form(max_length=20)] = "",
    how: Annotated[Literal["now", "stage"], Form()] = "now",
) -> Response:
    """Review a typed setpoint: old → new, limits, ramp."""
    try:
        raw, typed_with = await page.typed_setpoint(page.id, value)
        return await review_setpoint(page, raw, execute=how == "now", typed_with=typed_with)
    except (CallerError, Problem) as error:
        return explain_setpoint(page, error)


async def review_setpoint(
    page: UnitPage, raw: int, *, execute: bool = True, typed_with: UnitScale | None = None
) -> Response:
    """Review a setpoint; ``typed_with``: its scale, if it was typed. Raise Problem if it would not be
    sent."""
    await page.judge(SetSpeed(unit=page.id, raw=raw, execute=execute))
    await page.know_ramps([page.id])
    return page.review(
        "unit/_review_speed.html",
        unit=page.on_line,
        change=page.change(page.id, raw, typed_with),
        draws=draw_changes(page.bus, {page.id: raw}) if execute else [],
        execute=execute,
        follower=bool(follower(page.unit)),
    )


def explain_setpoint(page: UnitPage, error: CallerError | Problem) -> Response:
    """Render why there is no review, beside the field; a press on the nearest value enters it."""
    nearest = error.extra.get("nearest") if isinstance(error, Problem) else None
    status = error.status if isinstance(error, Problem) else 422
    return page.explain(error, ERROR_PLACE, nearest=page.setpoint(nearest), status=status)


@router.post("/speed", dependencies=[permitted_writer(SET_SPEED)])
async def set_speed(
    page: PageOfUnit,
    raw: SetpointField,
    confirmed: Confirmed,
    scale: ReviewedScale,
    how: Annotated[Literal["now", "stage"], Form()],
    was: SeenSetpoint = "",
) -> Response:
    """Send the reviewed setpoint, once, and show its result."""
    action = SetSpeed(unit=page.id, raw=raw, execute=how == "now")
    try:
        if not await page.has_sent(confirmed.id):
            _refuse_moved(page, was)
        result = await page.carry_out(action, confirmed, {page.id: scale})
    except Problem as problem:
        return page.not_sent(problem)
    return _done(page, raw, result, confirmed.id)


def _done(page: UnitPage, raw: int, result: Result, id: str) -> Response:
    # The screen has the commanded speed of a follower, but no ratio to compare with.
    reads = "" if follower(page.unit) else f"{page.on_line.key}.commanded"
    return page.result(
        page.outcome(result, page.id),
        requested=page.setpoint(raw),
        reads=reads,
        undo=page.undo(id),
    )


def _refuse_moved(page: UnitPage, was: str) -> None:
    if was != ("" if page.present is None else str(page.present)):
        raise Problem(409, "moved", Message("setpoint_moved"))


@router.post("/nudge", dependencies=[permitted_writer(SET_SPEED)])
async def nudge(
    page: PageOfUnit,
    step: Annotated[int, Form(ge=-99999, le=99999)],
    id: Annotated[str, Form(max_length=64)],
    scale: ReviewedScale,
) -> Response:
    """Send a small step from the unit's present setpoint, or review one that is larger than allowed, that
    moves a draw out of its band, or that takes no effect now."""
    try:
        if page.present is None:
            raise Problem(409, "unknown", Message("setpoint_unknown"))
        raw = page.present + step
        if raw < 0:
            raise Problem(422, "invalid", Message("step_below_zero"), nearest=0)
        if not _is_small(page, step) or _has_to_be_told(page, raw):
            return await review_setpoint(page, raw, execute=True, typed_with=scale)
        result = await page.send(SetSpeed(unit=page.id, raw=raw), id, scales={page.id: scale})
    except Problem as problem:
        return explain_setpoint(page, problem)
    response = _done(page, raw, result, id)
    response.headers["HX-Retarget"] = ERROR_PLACE
    return response


def _is_small(page: UnitPage, step: int) -> bool:
    allowed = page.guards.limits(page.id).largest_step
    return abs(step) <= (max(nudges(page.unit), default=0) if allowed is None else allowed)


def _has_to_be_told(page: UnitPage, raw: int) -> bool:
    return is_held(page.change(page.id, raw).risks) or leaves_band(page.bus, {page.id: raw})


@router.get("/execute", dependencies=[permitted(EXECUTE_SPEED)])
async def review_execute(page: PageOfUnit) -> Response:
    """Review executing the staged speed."""
    staged = page.unit.staged
    try:
        if staged is None:
            unknown = page.unit.staged_unknown
            lost = Message.of("staged_lost", names=[page.unit.settings.name])
            message = lost if unknown else Message("nothing_staged")
            raise Problem(409, "nothing_staged", message)
        await page.judge(ExecuteSpeed(unit=page.id))
        await page.know_ramps([page.id])
    except Problem as problem:
        return explain_setpoint(page, problem)
    change, draws = page.change(page.id, staged), draw_changes(page.bus, {page.id: staged})
    return page.review("unit/_review_execute.html", unit=page.on_line, change=change, draws=draws)


@router.post("/execute", dependencies=[permitted_writer(EXECUTE_SPEED)])
async def execute(
    page: PageOfUnit, confirmed: Confirmed, scale: ReviewedScale, raw: SetpointField, was: SeenSetpoint = ""
) -> Response:
    """Send 83h to one unit if its staged and its commanded value are still the reviewed ones."""
    try:
        if not await page.has_sent(confirmed.id):
            if page.unit.staged != raw:
                is_none = page.unit.staged is None and not page.unit.staged_unknown
                raise Problem(409, "moved", Message("nothing_staged" if is_none else "staged_moved"))
            _refuse_moved(page, was)
        result = await page.carry_out(ExecuteSpeed(unit=page.id), confirmed, {page.id: scale})
    except Problem as problem:
        return page.not_sent(problem)
    return _done(page, raw, result, confirmed.id)

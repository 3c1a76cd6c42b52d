"""The unit page, with the limits and the command block of its unit."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

from fastapi import APIRouter, Form
from starlette.responses import RedirectResponse, Response

from app.core.web.access import Person, Viewer
from app.errors import Problem
from app.line.commands.forms.page_context import OfUnit, UnitPage
from app.line.commands.limits import HIGHEST_SETPOINT, Limits
from app.line.commands.pages.faceplate import setting
from app.line.commands.safeguards import BLOCK, SET_LIMITS, UNBLOCK
from app.line.live.bus_live import UnitLive, setpoint_decimals
from bus.catalogue.numbers import ANALOG_OUT_HIGH, ANALOG_OUT_LOW, ANALOG_OUT_SOURCE
from bus.catalogue.values import speed_raw, speed_text
from bus.errors import CallerError
from bus.messages import Message, number
from bus.text import OneLine

router = APIRouter(prefix="/units/{bus}/{unit:int}", include_in_schema=False)
TypedLimit = Annotated[str, Form(max_length=20)]
SEE_OTHER = 303


@router.get("")
async def unit_page(_: Viewer, page: OfUnit) -> Response:
    """The faceplate of one unit."""
    return page.render("unit/page.html", **_faceplate(page))


def _faceplate(page: UnitPage) -> dict[str, Any]:
    unit, limits = page.unit, page.limits(page.id)
    return {
        **setting(page),
        "before": page.neighbor(-1),
        "after": page.neighbor(1),
        "limit_texts": {name: page.setpoint(getattr(limits, name)) for name in _LIMIT_NAMES},
        "analog_low": unit.parameter_raw(ANALOG_OUT_LOW),
        "analog_high": unit.parameter_raw(ANALOG_OUT_HIGH),
        "analog_by_link": unit.parameter_raw(ANALOG_OUT_SOURCE) == 2,
    }


_LIMIT_NAMES = ("lowest", "highest", "largest_step", "per_minute")


@router.post("/limits")
async def set_limits(
    person: Annotated[Person, SET_LIMITS.permitted],
    page: OfUnit,
    lowest: TypedLimit = "",
    highest: TypedLimit = "",
    largest_step: TypedLimit = "",
    per_minute: TypedLimit = "",
) -> Response:
    """All four at once; an empty field is no limit."""
    try:
        typed = (_raw(page.unit, text) for text in (lowest, highest, largest_step, per_minute))
        limits = replace(Limits(*typed), decimals=setpoint_decimals(page.unit))
        if limits.lowest is not None and limits.highest is not None and limits.lowest > limits.highest:
            raise CallerError(Message("limits_reversed"))
    except (CallerError, Problem) as error:
        return page.explain(error.message, "#limits-result")
    await page.guards.set_limits(person, page.id, limits)
    return page.render("unit/_limits_set.html")


def _raw(live: UnitLive, text: str) -> int | None:
    """Raises CallerError and Problem for what cannot be a limit."""
    if not text.strip():
        return None
    decimals = setpoint_decimals(live)
    if decimals is None:
        raise CallerError(Message("decimals_unknown"))
    raw = speed_raw(text, decimals)
    if raw > HIGHEST_SETPOINT:
        raise Problem(
            422,
            "invalid",
            Message.of("protocol_maximum", most=number(speed_text(HIGHEST_SETPOINT, decimals))),
        )
    return raw


@router.post("/block")
async def block(
    person: Annotated[Person, BLOCK.permitted],
    page: OfUnit,
    reason: Annotated[OneLine, Form(max_length=200)] = "",
) -> Response:
    """Refuse every write to this unit, with the reason shown on every page."""
    if not reason.strip():
        raise Problem(422, "invalid", Message("block_needs_reason"))
    await page.guards.block(person, page.id, reason.strip())
    return RedirectResponse(page.on_line.href, SEE_OTHER)


@router.post("/unblock")
async def unblock(person: Annotated[Person, UNBLOCK.permitted], page: OfUnit) -> Response:
    """Lift the block of commands; the event records the user."""
    await page.guards.lift(person, page.id)
    return RedirectResponse(page.on_line.href, SEE_OTHER)

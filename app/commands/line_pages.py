"""Many units as one change: the setpoints page."""

from __future__ import annotations

import time
from typing import Annotated

from fastapi import APIRouter, Form
from starlette.datastructures import FormData
from starlette.requests import Request
from starlette.responses import Response

from app.commands.bodies import Quantity
from app.commands.forms import TIMEOUT_S, Desks, Desktop
from app.commands.line_change import followers_of, proven, reviewed
from app.commands.ramp import Change, change_of, present_setpoint, sensible_bounds
from app.commands.speed_pages import refuse_outside
from app.commands.typed import Typed
from app.commands.words import shown_setpoint
from app.commands.zero import why_not_told
from app.errors import Problem
from app.live.state import BusLive, follower
from app.live.view import DECIMALS
from app.web.access import Operator, Person, Viewer
from bus.contract import SetLine
from bus.errors import CallerError

router = APIRouter(include_in_schema=False)
STAGE_S = 0.15
"""Time allowed for each unit of a change, besides the two seconds of one."""


def timeout_s(units: int) -> float:
    """How long a change of so many units may wait for the wire, seconds."""
    return TIMEOUT_S + STAGE_S * units


# --- the setpoints page -----------------------------------------------------------------------------


@router.get("/setpoints")
async def setpoints(_: Viewer, desk: Desks) -> Response:
    """Every unit with its present setpoint and room for a new one."""
    buses = [
        (name, [_line_of(desk, name, bus, number) for number in bus.units])
        for name, bus in desk.live.buses.items()
    ]
    return desk.render("setpoints/page.html", fields=desk.fields(), buses=buses)


def _line_of(desk: Desktop, name: str, bus: BusLive, number: int) -> dict[str, object]:
    live = bus.units[number]
    present = present_setpoint(bus, live)
    decimals = 4 if follower(live) else live.parameter_raw(DECIMALS)
    low, high = sensible_bounds(live, desk.guards.limits.of(name, number))
    limits = {"low": shown_setpoint(low, live), "high": shown_setpoint(high, live)}
    return {
        "unit": desk.shown(name, number),
        "limits": {end: desk.voice.formats.point(text) for end, text in limits.items()},
        "present_raw": "" if present is None else present,
        "decimals": "" if decimals is None else decimals,
        "follower": bool(follower(live)),
    }


@router.post("/setpoints/review")
async def review_setpoints(request: Request, person: Operator, desk: Desks) -> Response:
    """Each new setpoint that was typed, judged: old → new, limits, ramps, in one table."""
    form = await request.form()
    bus = str(form.get("bus", ""))
    live = desk.bus(bus)
    try:
        changes = await _changes(person, desk, bus, live, form)
        setpoints = {change.unit: change.new_raw for change in changes}
        desk.desk.check(person, bus, SetLine(setpoints=setpoints), confirm=True)
    except (CallerError, Problem) as error:
        return desk.not_so(error.text(desk.voice.t), f"#setpoints-error-{bus}")
    return desk.review(
        "setpoints/_review.html",
        bus=bus,
        changes=changes,
        obstacles=_obstacles(desk, live, changes),
        followers=followers_of(live),
        longest_s=2 * timeout_s(len(changes)),
    )


def _obstacles(desk: Desktop, live: BusLive, changes: list[Change]) -> list[tuple[str, str]]:
    """(name, reason) of each unit that will not take its part, so that nothing will be executed."""
    now = time.time()
    reasons = ((change, why_not_told(live, live.units[change.unit], False, now)) for change in changes)
    return [(change.name, desk.voice.t(reason)) for change, reason in reasons if reason]


async def _changes(person: Person, desk: Desktop, bus: str, live: BusLive, form: FormData) -> list[Change]:
    changes = []
    for number, unit in live.units.items():
        text = str(form.get(f"new-{number}", "")).strip()
        if not text:
            continue
        try:
            raw = await Typed(desk.desk, person, bus, unit, TIMEOUT_S).setpoint(Quantity(value=text))
            refuse_outside(desk, bus, unit, raw)
        except (CallerError, Problem) as error:
            params = {"name": unit.settings.name, "reason": error}
            raise CallerError("{name}: {reason}", params=params) from error
        changes.append(change_of(live, unit, raw, desk.guards.limits.of(bus, number)))
    if not changes:
        raise CallerError("no new setpoint is given; empty is not zero")
    return changes


@router.post("/setpoints")
async def set_setpoints(
    request: Request,
    person: Operator,
    desk: Desks,
    bus: Annotated[str, Form()],
    id: Annotated[str, Form(max_length=64)],
    reviewed_at: Annotated[float, Form()],
) -> Response:
    """Stage all, require every acknowledgement, one broadcast, prove each: all of them or none."""
    live = desk.bus(bus)
    form = await request.form()
    title = desk.voice.t("Setpoints")
    try:
        desk.refuse_lapsed(reviewed_at)
        setpoints = reviewed(live, form)
        result = await desk.ask(person, bus, SetLine(setpoints=setpoints), id, timeout_s(len(setpoints)))
    except Problem as problem:
        return desk.refused(problem, title)
    return proven(desk, bus, title, setpoints, result, form)

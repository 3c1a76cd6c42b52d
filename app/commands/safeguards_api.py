"""Limits, blocks and control over HTTP: what keeps a wish from being sent, and who said so."""

from __future__ import annotations

from typing import Annotated, Any, cast

from fastapi import APIRouter
from pydantic import ConfigDict, Field, model_validator
from starlette.requests import HTTPConnection

from app.commands.control import LAPSES_AFTER_S, Holding
from app.commands.limits import HIGHEST_SETPOINT, Limits
from app.commands.safeguards import Safeguards
from app.live.api import Live
from app.live.lookup import bus_or_404, unit_or_404
from app.web.access import Engineer, Operator, Viewer, name_of
from app.web.api_route import ApiRoute
from app.web.services import looked_up
from app.web.shape import Strict, iso
from bus.text import OneLine

router = APIRouter(prefix="/api/v1/buses/{bus}", tags=["limits, blocks, control"], route_class=ApiRoute)

Setpoint = Annotated[int, Field(ge=0, le=HIGHEST_SETPOINT)]


class LimitsBody(Strict):
    """All four in raw setpoint units; null or left out: no limit."""

    lowest: Setpoint | None = None
    highest: Setpoint | None = None
    largest_step: Setpoint | None = None
    per_minute: Setpoint | None = None

    @model_validator(mode="after")
    def _leave_something(self) -> LimitsBody:
        if self.lowest is not None and self.highest is not None and self.lowest > self.highest:
            raise ValueError("lowest is above highest, so no setpoint would be left")
        return self


class BlockBody(Strict):
    """Why the unit must not be commanded."""

    model_config = ConfigDict(str_strip_whitespace=True)

    reason: Annotated[OneLine, Field(min_length=1, max_length=200)]


class HandOverBody(Strict):
    """Who shall hold control."""

    model_config = ConfigDict(str_strip_whitespace=True)

    to: Annotated[str, Field(min_length=1, max_length=60)]


def safeguards_of(connection: HTTPConnection) -> Safeguards:
    """Limits, blocks and control of every line."""
    return cast(Safeguards, connection.app.state.services.safeguards)


Guards = Annotated[Safeguards, looked_up(safeguards_of)]


@router.get("/units/{unit:int}/limits")
async def get_limits(_: Viewer, live: Live, guards: Guards, bus: str, unit: int) -> LimitsBody:
    """What an engineer allows for the speed of this unit."""
    unit_or_404(live, bus, unit)
    limits = guards.limits.of(bus, unit)
    return LimitsBody(
        lowest=limits.lowest,
        highest=limits.highest,
        largest_step=limits.largest_step,
        per_minute=limits.per_minute,
    )


@router.put("/units/{unit:int}/limits")
async def put_limits(
    person: Engineer, live: Live, guards: Guards, bus: str, unit: int, body: LimitsBody
) -> LimitsBody:
    """Replace the limits of this unit. They hold on every path at once."""
    unit_or_404(live, bus, unit)
    await guards.set_limits(person, bus, unit, Limits(**body.model_dump()))
    return body


@router.get("/units/{unit:int}/block")
async def get_block(_: Viewer, live: Live, guards: Guards, bus: str, unit: int) -> dict[str, Any]:
    """Whether this unit is blocked, why and by whom."""
    unit_or_404(live, bus, unit)
    return _block_json(guards, bus, unit)


@router.post("/units/{unit:int}/block")
async def block(
    person: Operator, live: Live, guards: Guards, bus: str, unit: int, body: BlockBody
) -> dict[str, Any]:
    """Refuse every write to this unit, on every path, until somebody lifts it."""
    unit_or_404(live, bus, unit)
    await guards.block(person, bus, unit, body.reason)
    return _block_json(guards, bus, unit)


@router.delete("/units/{unit:int}/block")
async def lift_block(person: Operator, live: Live, guards: Guards, bus: str, unit: int) -> dict[str, Any]:
    """Free this unit; the events keep who did."""
    unit_or_404(live, bus, unit)
    await guards.lift(person, bus, unit)
    return _block_json(guards, bus, unit)


@router.get("/control")
async def get_control(_: Viewer, live: Live, guards: Guards, bus: str) -> dict[str, Any]:
    """Who holds control of this line, where the site wants one person at a time."""
    bus_or_404(live, bus)
    return _control_json(guards, guards.holding(bus))


@router.post("/control")
async def take_control(person: Operator, live: Live, guards: Guards, bus: str) -> dict[str, Any]:
    """Take control that nobody else holds."""
    bus_or_404(live, bus)
    return _control_json(guards, await guards.take(person, bus))


@router.post("/control/hand-over")
async def hand_over_control(
    person: Operator, live: Live, guards: Guards, bus: str, body: HandOverBody
) -> dict[str, Any]:
    """Give control to somebody else who may set the line. An admin may do so without holding it."""
    bus_or_404(live, bus)
    return _control_json(guards, await guards.hand_over(person, bus, body.to))


@router.delete("/control")
async def release_control(person: Operator, live: Live, guards: Guards, bus: str) -> dict[str, Any]:
    """Give control back."""
    bus_or_404(live, bus)
    await guards.release(person, bus)
    return _control_json(guards, None)


def _block_json(guards: Safeguards, bus: str, unit: int) -> dict[str, Any]:
    block = guards.blocks.of(bus, unit)
    if block is None:
        return {"blocked": False, "reason": None, "by": None, "since": None}
    return {"blocked": True, "reason": block.reason, "by": block.set_by, "since": iso(block.set_at)}


def _control_json(guards: Safeguards, holding: Holding | None) -> dict[str, Any]:
    said = {"required": guards.control.required, "lapses_after_s": LAPSES_AFTER_S}
    if holding is None:
        return {**said, "holder": None, "is_token": None, "since": None, "lapses_at": None}
    name, is_token = name_of(holding.holder)
    return {
        **said,
        "holder": name,
        "is_token": is_token,
        "since": iso(holding.since),
        "lapses_at": iso(holding.lapses_at),
    }

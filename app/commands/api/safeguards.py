"""Limits, blocks, control and the range of a setpoint over HTTP: what keeps a command from being sent, and
who set it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter
from pydantic import ConfigDict, Field, model_validator
from typing_extensions import TypedDict

from app.commands.acts import BLOCK, HAND_OVER_CONTROL, RELEASE_CONTROL, SET_LIMITS, TAKE_CONTROL, UNBLOCK
from app.commands.api.commands import UnitInPath
from app.commands.api.responses import Moment
from app.commands.rules.setpoint_range import Basis, SetpointKind, setpoint_range
from app.commands.safeguards.control import LAPSES_AFTER_S, Holding
from app.commands.safeguards.limits import HIGHEST_SETPOINT, Limits
from app.commands.safeguards.service import Safeguards
from app.live.api.schemas import DisplayedValue
from app.live.api.view import setpoint_text
from app.web.access import Person, Viewer, name_of
from app.web.api_route import ApiRoute
from app.web.services import bus_service
from app.web.shape import StrictBody, iso
from bus.messages import Message
from bus.text import OneLine

router = APIRouter(prefix="/api/v1/buses/{bus}", tags=["limits, blocks, control"], route_class=ApiRoute)

LimitSetpoint = Annotated[int, Field(ge=0, le=HIGHEST_SETPOINT)]


class SpeedLimits(StrictBody):
    """All four in raw setpoint units; null or left out: no limit."""

    lowest: Annotated[LimitSetpoint | None, Field(description="Lowest setpoint, raw.")] = None
    highest: Annotated[LimitSetpoint | None, Field(description="Highest setpoint, raw.")] = None
    largest_step: Annotated[LimitSetpoint | None, Field(description="Largest step of one command, raw.")] = (
        None
    )
    per_minute: Annotated[LimitSetpoint | None, Field(description="Largest movement in a minute, raw.")] = (
        None
    )

    @model_validator(mode="after")
    def _leave_something(self) -> SpeedLimits:
        if self.lowest is not None and self.highest is not None and self.lowest > self.highest:
            raise ValueError(Message("no_setpoint_left"))
        return self


class CommandBlockRequest(StrictBody):
    """Why the unit must not be commanded."""

    model_config = ConfigDict(str_strip_whitespace=True)

    reason: Annotated[OneLine, Field(min_length=1, max_length=200)]


class HandOverRequest(StrictBody):
    """Who shall hold control."""

    model_config = ConfigDict(str_strip_whitespace=True)

    to: Annotated[str, Field(min_length=1, max_length=60)]


class CommandBlockShown(TypedDict):
    """Whether commands to a unit are blocked."""

    blocked: bool
    reason: str | None
    by: Annotated[str | None, Field(description="Who blocked it; null: it is not blocked.")]
    since: Moment


class ControlShown(TypedDict):
    """Who has control of a line."""

    required: Annotated[bool, Field(description="Whether commands need control (control in [site]).")]
    lapses_after_s: Annotated[
        float, Field(description="Control without a command lapses after this, seconds.")
    ]
    holder: Annotated[str | None, Field(description="Name of the user or token; null: control is free.")]
    is_token: Annotated[bool | None, Field(description="Whether the holder is a token.")]
    since: Moment
    lapses_at: Moment


Guards = Annotated[Safeguards, bus_service(Safeguards)]


@router.get("/units/{unit:int}/limits")
async def get_speed_limits(_: Viewer, guards: Guards, unit: UnitInPath) -> SpeedLimits:
    """Limits of the setpoint of this unit, set by an engineer."""
    return SpeedLimits(**asdict(guards.limits.of(unit.settings.id)))


@router.put("/units/{unit:int}/limits")
async def set_speed_limits(
    person: Annotated[Person, SET_LIMITS.permitted], guards: Guards, unit: UnitInPath, body: SpeedLimits
) -> SpeedLimits:
    """Replace the limits of this unit. They apply immediately on every interface."""
    await guards.set_limits(person, unit.settings.id, Limits(**body.model_dump()))
    return body


@router.get("/units/{unit:int}/block")
async def get_command_block(_: Viewer, guards: Guards, unit: UnitInPath) -> CommandBlockShown:
    """Whether commands to this unit are blocked, the reason and the user."""
    return _block_json(guards, unit.settings.id)


@router.post("/units/{unit:int}/block")
async def block_commands(
    person: Annotated[Person, BLOCK.permitted], guards: Guards, unit: UnitInPath, body: CommandBlockRequest
) -> CommandBlockShown:
    """Block every write to this unit, on every interface, until the block is lifted."""
    await guards.block(person, unit.settings.id, body.reason)
    return _block_json(guards, unit.settings.id)


@router.delete("/units/{unit:int}/block")
async def unblock_commands(
    person: Annotated[Person, UNBLOCK.permitted], guards: Guards, unit: UnitInPath
) -> CommandBlockShown:
    """Lift the block of commands; the event records the user."""
    await guards.lift(person, unit.settings.id)
    return _block_json(guards, unit.settings.id)


@router.get("/control")
async def get_control(_: Viewer, guards: Guards) -> ControlShown:
    """The user who has control of this line, if the site requires control."""
    return _control_json(guards, guards.holding())


@router.post("/control")
async def take_control(person: Annotated[Person, TAKE_CONTROL.permitted], guards: Guards) -> ControlShown:
    """Take control, if it is free."""
    return _control_json(guards, await guards.take(person))


@router.post("/control/hand-over")
async def hand_over_control(
    person: Annotated[Person, HAND_OVER_CONTROL.permitted], guards: Guards, body: HandOverRequest
) -> ControlShown:
    """Hand control over to another user who may command the line. An admin may do so without control."""
    return _control_json(guards, await guards.hand_over(person, body.to))


@router.delete("/control")
async def release_control(
    person: Annotated[Person, RELEASE_CONTROL.permitted], guards: Guards
) -> ControlShown:
    """Release control."""
    await guards.release(person)
    return _control_json(guards, None)


def _block_json(guards: Safeguards, unit: int) -> CommandBlockShown:
    block = guards.blocks.of(unit)
    if block is None:
        return {"blocked": False, "reason": None, "by": None, "since": None}
    return {"blocked": True, "reason": block.reason, "by": block.set_by, "since": iso(block.set_at)}


def _control_json(guards: Safeguards, holding: Holding | None) -> ControlShown:
    name, is_token = (None, None) if holding is None else name_of(holding.holder)
    return {
        "required": guards.control.required,
        "lapses_after_s": LAPSES_AFTER_S,
        "holder": name,
        "is_token": is_token,
        "since": None if holding is None else iso(holding.since),
        "lapses_at": None if holding is None else iso(guards.lapses_at(holding)),
    }


class SetpointRangeShown(StrictBody):
    """Range of the setpoints of a unit, both ends included."""

    kind: SetpointKind
    lowest_raw: Annotated[int, Field(description="Integer on the wire, 0 to 99999.")]
    highest_raw: Annotated[int, Field(description="Integer on the wire, 0 to 99999.")]
    lowest: DisplayedValue
    highest: DisplayedValue
    basis: Annotated[Basis, Field(description="Source of the limit: 82h, #2, #38 and #31, or an engineer.")]


@router.get("/units/{unit:int}/setpoint-range")
async def get_setpoint_range(_: Viewer, guards: Guards, unit: UnitInPath) -> SetpointRangeShown:
    """Range of the setpoints of this unit, as on every page and for every write."""
    allowed = setpoint_range(unit, guards.limits.of(unit.settings.id))
    return SetpointRangeShown(
        kind=allowed.kind,
        lowest_raw=allowed.lowest,
        highest_raw=allowed.highest,
        lowest=setpoint_text(unit, allowed.lowest),
        highest=setpoint_text(unit, allowed.highest),
        basis=allowed.basis,
    )

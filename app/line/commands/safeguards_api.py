"""Limits, blocks, control and the range of a setpoint over HTTP: the restrictions of commands, and who set
them."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter
from pydantic import ConfigDict, Field, model_validator
from starlette.responses import Response
from typing_extensions import TypedDict

from app.core.web.access import Person, Viewer, name_of
from app.core.web.api import ApiRoute, limited
from app.core.web.services import bus_service
from app.core.web.shape import StrictBody, iso
from app.line.commands.api import Moment, UnitInPath
from app.line.commands.control import LAPSES_AFTER_S, REQUEST_LAPSES_AFTER_S
from app.line.commands.limits import HIGHEST_SETPOINT, MAX_READ_ONLY_MINUTES, Limits
from app.line.commands.rules import Basis, SetpointKind, setpoint_range
from app.line.commands.safeguards import (
    BLOCK,
    END_CONTROL_REQUEST,
    GRANT_CONTROL,
    HAND_OVER_CONTROL,
    RELEASE_CONTROL,
    REQUEST_CONTROL,
    SET_LIMITS,
    SET_READ_ONLY,
    TAKE_CONTROL,
    UNBLOCK,
    Safeguards,
)
from app.line.live.api.view import DisplayedValue, setpoint_text
from bus.messages import Message
from bus.validation import OneLine, TypedText

router = APIRouter(prefix="/api/v1/buses/{bus}", tags=["limits, blocks, control"], route_class=ApiRoute)

LimitSetpoint = Annotated[int, Field(ge=0, le=HIGHEST_SETPOINT)]


class SpeedLimits(StrictBody):
    """The four limits in raw setpoint units; null or left out: no limit."""

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
    """A reason to block commands to a unit."""

    model_config = ConfigDict(str_strip_whitespace=True)

    reason: Annotated[OneLine, Field(min_length=1, max_length=200)]


class ReadOnlyRequest(StrictBody):
    """A change of the read-only mode of a bus."""

    model_config = ConfigDict(str_strip_whitespace=True)

    on: bool
    reason: Annotated[OneLine | None, Field(max_length=200, description="Required to set it.")] = None
    minutes: Annotated[
        int | None,
        Field(ge=1, le=MAX_READ_ONLY_MINUTES, description="Duration, minutes; null: until it is ended."),
    ] = None

    @model_validator(mode="after")
    def _give_a_reason(self) -> ReadOnlyRequest:
        if self.on and not self.reason:
            raise ValueError(Message("read_only_needs_reason"))
        return self


class HandOverRequest(StrictBody):
    """The user who is to hold control."""

    model_config = ConfigDict(str_strip_whitespace=True)

    to: Annotated[TypedText, Field(min_length=1, max_length=60)]


class CommandBlockShown(TypedDict):
    """The block of a unit, if commands to it are blocked."""

    blocked: bool
    reason: str | None
    by: Annotated[str | None, Field(description="Who blocked it; null: it is not blocked.")]
    since: Moment


class ReadOnlyShown(TypedDict):
    """The read-only mode of a bus, in which commands to it are refused."""

    on: bool
    reason: str | None
    by: Annotated[str | None, Field(description="Who set it; null: it is not read-only.")]
    since: Moment
    until: Annotated[Moment, Field(description="End of its duration; null: until it is ended.")]


class ControlRequestShown(TypedDict):
    """A request for control, shown for a minute after its end too."""

    by: Annotated[str, Field(description="Name of the user or token.")]
    is_token: bool
    state: Literal["pending", "declined", "lapsed"]
    until: Annotated[Moment, Field(description="When it lapses, or is shown no longer.")]


class ControlShown(TypedDict):
    """The control of a line: its holder and a request for it."""

    required: Annotated[bool, Field(description="Whether commands need control (control in [site]).")]
    lapses_after_s: Annotated[
        float, Field(description="Control without a command lapses after this, seconds.")
    ]
    holder: Annotated[str | None, Field(description="Name of the user or token; null: control is free.")]
    is_token: Annotated[bool | None, Field(description="Whether the holder is a token.")]
    since: Moment
    lapses_at: Moment
    request_lapses_after_s: Annotated[
        float, Field(description="A request without a response of the holder lapses after this, seconds.")
    ]
    request: Annotated[ControlRequestShown | None, Field(description="null: control is not requested.")]


Guards = Annotated[Safeguards, bus_service(Safeguards)]


@router.get("/units/{unit:int}/limits")
async def get_speed_limits(_: Viewer, guards: Guards, unit: UnitInPath) -> SpeedLimits:
    """Return the limits of the setpoint of this unit, set by an engineer."""
    limits = guards.limits(unit.settings.id)
    return SpeedLimits(**{name: getattr(limits, name) for name in SpeedLimits.model_fields})


@router.put("/units/{unit:int}/limits")
async def set_speed_limits(
    person: Annotated[Person, SET_LIMITS.permitted], guards: Guards, unit: UnitInPath, body: SpeedLimits
) -> SpeedLimits:
    """Replace the limits of this unit. They apply immediately on every interface."""
    await guards.set_limits(person, unit.settings.id, Limits(**body.model_dump()))
    return body


@router.get("/units/{unit:int}/block")
async def get_command_block(_: Viewer, guards: Guards, unit: UnitInPath) -> CommandBlockShown:
    """Return whether commands to this unit are blocked, the reason and the user."""
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


@router.get("/read-only")
async def get_read_only(_: Viewer, guards: Guards) -> ReadOnlyShown:
    """Return whether commands to the units of this bus are refused, the reason and the user."""
    return _read_only_json(guards)


@router.post("/read-only")
async def set_read_only(
    person: Annotated[Person, SET_READ_ONLY.permitted], guards: Guards, body: ReadOnlyRequest
) -> ReadOnlyShown:
    """Refuse every write to this bus, on every interface, or accept commands again."""
    if body.on:
        await guards.set_read_only(person, body.reason or "", body.minutes)
    else:
        await guards.end_read_only(person)
    return _read_only_json(guards)


@router.get("/control")
async def get_control(_: Viewer, guards: Guards) -> ControlShown:
    """Return the user who has control of this line, if the site requires control."""
    return _control_json(guards)


@router.post("/control")
@router.post("/control/take", operation_id="take_control_by_name")
async def take_control(person: Annotated[Person, TAKE_CONTROL.permitted], guards: Guards) -> ControlShown:
    """Take control of the bus, if it is free."""
    await guards.take(person)
    return _control_json(guards)


@router.post("/control/request", responses=limited(200))
async def request_control(
    person: Annotated[Person, REQUEST_CONTROL.permitted], guards: Guards, response: Response
) -> ControlShown:
    """Request control from its holder, on every page that the holder has open. Only the holder grants it."""
    await guards.request(person)
    response.headers.update(guards.request_limit(person).headers)
    return _control_json(guards)


@router.delete("/control/request")
async def end_control_request(
    person: Annotated[Person, END_CONTROL_REQUEST.permitted], guards: Guards
) -> ControlShown:
    """Withdraw one's own request, or decline that of another as the holder."""
    await guards.end_request(person)
    return _control_json(guards)


@router.post("/control/grant")
async def grant_control(person: Annotated[Person, GRANT_CONTROL.permitted], guards: Guards) -> ControlShown:
    """Hand control over to the account that has requested it."""
    await guards.grant(person)
    return _control_json(guards)


@router.post("/control/hand-over")
async def hand_over_control(
    person: Annotated[Person, HAND_OVER_CONTROL.permitted], guards: Guards, body: HandOverRequest
) -> ControlShown:
    """Hand control over to another user who may command the line. An admin may do so without control."""
    await guards.hand_over(person, body.to)
    return _control_json(guards)


@router.delete("/control")
@router.post("/control/release", operation_id="release_control_by_name")
async def release_control(
    person: Annotated[Person, RELEASE_CONTROL.permitted], guards: Guards
) -> ControlShown:
    """Release control of the bus."""
    await guards.release(person)
    return _control_json(guards)


def _block_json(guards: Safeguards, unit: int) -> CommandBlockShown:
    block = guards.block_of(unit)
    if block is None:
        return {"blocked": False, "reason": None, "by": None, "since": None}
    return {"blocked": True, "reason": block.reason, "by": block.set_by, "since": iso(block.set_at)}


def _read_only_json(guards: Safeguards) -> ReadOnlyShown:
    mode = guards.read_only()
    if mode is None:
        return {"on": False, "reason": None, "by": None, "since": None, "until": None}
    until = iso(mode.until) if mode.until is not None else None
    return {"on": True, "reason": mode.reason, "by": mode.set_by, "since": iso(mode.set_at), "until": until}


def _control_json(guards: Safeguards) -> ControlShown:
    now = guards.bus_control()
    name, is_token = name_of(now.holder)
    by, by_token = name_of(now.requester)
    request: ControlRequestShown | None = None
    if now.request:
        request = {"by": by, "is_token": by_token, "state": now.request, "until": iso(now.request_until)}
    return {
        "required": guards.control.required,
        "lapses_after_s": LAPSES_AFTER_S,
        "holder": name or None,
        "is_token": is_token if now.holder else None,
        "since": iso(now.since) if now.holder else None,
        "lapses_at": iso(now.lapses_at) if now.holder else None,
        "request_lapses_after_s": REQUEST_LAPSES_AFTER_S,
        "request": request,
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
    """Return the range of the setpoints of this unit, as on every page and for every write."""
    allowed = setpoint_range(unit, guards.limits(unit.settings.id))
    return SetpointRangeShown(
        kind=allowed.kind,
        lowest_raw=allowed.lowest,
        highest_raw=allowed.highest,
        lowest=setpoint_text(unit, allowed.lowest),
        highest=setpoint_text(unit, allowed.highest),
        basis=allowed.basis,
    )

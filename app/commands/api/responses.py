"""The result of a command as an HTTP response."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from app.commands.api.schemas import FrameShown, OutcomeMembers
from app.errors import Problem
from app.live.state.bus_live import BusLive
from app.web.problems import respond
from app.web.shape import ReasonShown, iso, message_shown, reason_shown
from bus.contract import Frame, Result, UnitOutcome
from bus.errors import unit_error, unit_error_name
from bus.instants import UnixTime
from bus.messages import Message

STATUS = {
    "verified": 200,
    "acknowledged": 200,
    "refused": 409,
    "invalid": 422,
    "unverified": 504,
    "bus_closed": 503,
    "not_sent": 503,
}

FramesWanted = Annotated[bool, Query(description="With the frames that carried the command.")]
_OF_A_PROBLEM = {"code", *ReasonShown.__annotations__}
"""What a problem has without the members of a result."""


def command_response(
    request: Request, bus: BusLive, result: Result, unit: int | None = None, *, frames: bool = False
) -> Response:
    """200 with the result, or the problem it stands for; the members are the same in both. ``frames``: with
    what carried the command."""
    body = result_json(bus, result, unit)
    if frames:
        body["frames"] = [frame_json(frame) for frame in result.frames]
    status = STATUS[result.outcome]
    if status == 200:
        return JSONResponse(body)
    members = {name: value for name, value in body.items() if name not in _OF_A_PROBLEM}
    return respond(request, Problem(status, result.outcome, outcome_message(result), **members))


def result_json(bus: BusLive, result: Result, unit: int | None = None) -> dict[str, Any]:
    """``units``: of a command to several the result of each, keyed by its number as text; of one to ``unit``
    the members are its own."""
    by_unit = {str(part.unit): _unit_json(part) for part in result.units}
    alone = {} if unit is None else by_unit.pop(str(unit), {})
    return {
        **alone,
        "id": result.id,
        "at": iso(result.at),
        "bus": bus.settings.name,
        "unit": unit,
        "code": result.outcome,
        **_outcome_json(result),
        "skew_s": result.skew_s,
        "units": by_unit,
    }


def outcome_message(result: Result | UnitOutcome) -> Message:
    if result.message:
        return result.message
    outcome = Message(f"outcome_{result.outcome}")
    if result.unit_error is None:
        return outcome
    return Message.of("outcome_because", outcome=outcome, reason=unit_error(result.unit_error))


def frame_json(frame: Frame) -> FrameShown:
    """One frame as it passed the port."""
    return {
        "at": iso(frame.at),
        "direction": frame.direction,
        "hex": frame.data.hex(" ").upper(),
        "meaning": frame.meaning,
        "meanings": [message_shown(meaning) for meaning in frame.meanings],
        "valid": frame.valid,
    }


def _unit_json(result: UnitOutcome) -> dict[str, Any]:
    return {
        "unit": result.unit,
        **_outcome_json(result),
        "sent_at": _moment(result.sent_at),
        "acknowledged_at": _moment(result.acknowledged_at),
        "proven_at": _moment(result.proven_at),
        "attempts": result.attempts,
    }


def _outcome_json(result: Result | UnitOutcome) -> OutcomeMembers:
    return {
        "outcome": result.outcome,
        **reason_shown(outcome_message(result)),
        "read_back": result.read_back,
        "unit_error": result.unit_error,
        "unit_error_name": None if result.unit_error is None else unit_error_name(result.unit_error),
    }


def _moment(at: UnixTime | None) -> str | None:
    return None if at is None else iso(at)

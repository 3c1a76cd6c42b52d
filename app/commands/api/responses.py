"""The result of a command as an HTTP response."""

from __future__ import annotations

from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from app.commands.api.schemas import FrameShown, OutcomeMembers
from app.errors import Problem
from app.live.state.bus_live import BusLive
from app.web.problems import respond
from app.web.shape import iso, maybe_shown, message_shown
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


def command_response(
    request: Request, bus: BusLive, result: Result, unit: int | None = None, *, secret: bool = False
) -> Response:
    """200 with the result, or the problem it stands for; the members are the same in both."""
    body = result_json(bus, result, unit, secret=secret)
    status = STATUS[result.outcome]
    if status == 200:
        return JSONResponse(body)
    return respond(request, Problem(status, result.outcome, outcome_message(result), **_members(body)))


def result_json(
    bus: BusLive, result: Result, unit: int | None = None, *, secret: bool = False
) -> dict[str, Any]:
    """``units``: the result of each unit, keyed by its number as text. The value of a secret is left out."""
    by_unit = {str(part.unit): _unit_json(part, secret) for part in result.units}
    alone = by_unit.get(str(unit), {}) if unit is not None else {}
    return {
        **alone,
        "id": result.id,
        "at": iso(result.at),
        "bus": bus.settings.name,
        "unit": unit,
        **_outcome_json(result, secret),
        "skew_s": result.skew_s,
        "units": by_unit,
        "frames": [] if secret else [frame_json(frame) for frame in result.frames],
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
        "time": frame.at,
        "direction": frame.direction,
        "hex": frame.data.hex(" ").upper(),
        "meaning": frame.meaning,
        "meanings": [message_shown(meaning) for meaning in frame.meanings],
        "valid": frame.valid,
    }


def _unit_json(result: UnitOutcome, secret: bool) -> dict[str, Any]:
    return {
        "unit": result.unit,
        **_outcome_json(result, secret),
        "sent_at": _moment(result.sent_at),
        "acknowledged_at": _moment(result.acknowledged_at),
        "proven_at": _moment(result.proven_at),
        "attempts": result.attempts,
    }


def _outcome_json(result: Result | UnitOutcome, secret: bool) -> OutcomeMembers:
    return {
        "outcome": result.outcome,
        "code": result.outcome,
        "message": str(outcome_message(result)),
        "reason": maybe_shown(result.message),
        "read_back": None if secret else result.read_back,
        "unit_error": result.unit_error,
        "unit_error_name": None if result.unit_error is None else unit_error_name(result.unit_error),
    }


def _moment(at: UnixTime | None) -> str | None:
    return None if at is None else iso(at)


def _members(body: dict[str, Any]) -> dict[str, Any]:
    """Those that a problem does not have of itself."""
    return {name: value for name, value in body.items() if name not in ("code", "reason")}

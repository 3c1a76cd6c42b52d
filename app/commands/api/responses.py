"""The fate of a command as an HTTP answer."""

from __future__ import annotations

from typing import Any

from msgspec import to_builtins
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from app.commands.api.schemas import FrameShown, OutcomeMembers
from app.errors import Problem
from app.live.state.bus_live import BusLive
from app.web.problems import respond
from app.web.shape import iso
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


def answer(
    request: Request, bus: BusLive, result: Result, unit: int | None = None, *, secret: bool = False
) -> Response:
    """200 with the fate, or the problem that it is; the members are the same in both."""
    body = fate_json(bus, result, unit, secret=secret)
    status = STATUS[result.outcome]
    if status == 200:
        return JSONResponse(body)
    return respond(request, Problem(status, result.outcome, outcome_message(result), **_members(body)))


def fate_json(
    bus: BusLive, result: Result, unit: int | None = None, *, secret: bool = False
) -> dict[str, Any]:
    """``units`` holds the fate at each unit, by its number as text. A secret's value is left out."""
    fates = {str(fate.unit): _unit_json(fate, secret) for fate in result.units}
    alone = fates.get(str(unit), {}) if unit is not None else {}
    return {
        **alone,
        "id": result.id,
        "at": iso(result.at),
        "bus": bus.settings.name,
        "unit": unit,
        **_outcome_json(result, secret),
        "skew_s": result.skew_s,
        "units": fates,
        "frames": [] if secret else [frame_json(frame) for frame in result.frames],
    }


def outcome_message(result: Result | UnitOutcome) -> Message:
    """What became of it."""
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
        "valid": frame.valid,
    }


def _unit_json(fate: UnitOutcome, secret: bool) -> dict[str, Any]:
    return {
        "unit": fate.unit,
        **_outcome_json(fate, secret),
        "sent_at": _moment(fate.sent_at),
        "acknowledged_at": _moment(fate.acknowledged_at),
        "proven_at": _moment(fate.proven_at),
        "attempts": fate.attempts,
    }


def _outcome_json(fate: Result | UnitOutcome, secret: bool) -> OutcomeMembers:
    return {
        "outcome": fate.outcome,
        "code": fate.outcome,
        "message": str(outcome_message(fate)),
        "reason": to_builtins(fate.message),
        "read_back": None if secret else fate.read_back,
        "unit_error": fate.unit_error,
        "unit_error_name": None if fate.unit_error is None else unit_error_name(fate.unit_error),
    }


def _moment(at: UnixTime | None) -> str | None:
    return None if at is None else iso(at)


def _members(body: dict[str, Any]) -> dict[str, Any]:
    """Those that a problem does not have of itself."""
    return {name: value for name, value in body.items() if name not in ("code", "reason")}

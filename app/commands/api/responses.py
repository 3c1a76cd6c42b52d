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
from bus.errors import unit_error_name
from bus.messages import in_english

STATUS = {
    "verified": 200,
    "acknowledged": 200,
    "refused": 409,
    "invalid": 422,
    "unverified": 504,
    "bus_closed": 503,
    "not_sent": 503,
}
_WORDS = {
    "verified": "read back and equal",
    "acknowledged": "the unit acknowledged it",
    "refused": "the unit refused",
    "invalid": "nothing was sent",
    "unverified": "no proof: whether the unit acted is not known",
    "bus_closed": "no link to the bus; nothing was sent",
    "not_sent": "the wire was not free in time; nothing was sent",
}


def command_response(
    request: Request, bus: BusLive, result: Result, unit: int | None = None, *, secret: bool = False
) -> Response:
    """200 with the fate, or the problem that it is; the members are the same in both."""
    body = result_json(bus, result, unit, secret=secret)
    status = STATUS[result.outcome]
    if status == 200:
        return JSONResponse(body)
    detail = result.message or body["message"]
    return respond(request, Problem(status, result.outcome, detail, **_members(body)))


def result_json(
    bus: BusLive, result: Result, unit: int | None = None, *, secret: bool = False
) -> dict[str, Any]:
    """``units`` holds the fate at each unit, by its number as text. A secret's value is left out."""
    by_unit = {str(part.unit): _unit_json(part, secret) for part in result.units}
    alone = by_unit.get(str(unit), {}) if unit is not None else {}
    return {
        **alone,
        "id": result.id,
        "at": iso(result.at),
        "bus": bus.settings.name,
        "unit": unit,
        **_outcome_members(result, in_words(result), secret),
        "skew_s": result.skew_s,
        "units": by_unit,
        "frames": [] if secret else [frame_json(frame) for frame in result.frames],
    }


def in_words(result: Result) -> str:
    """What became of it, as a sentence."""
    if result.message:
        return str(result.message)
    name = _error_name(result.unit_error)
    return f"{_WORDS[result.outcome]}: {name}" if name else _WORDS[result.outcome]


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


def _unit_json(result: UnitOutcome, secret: bool) -> dict[str, Any]:
    return {
        "unit": result.unit,
        **_outcome_members(result, in_english(result.message) or _WORDS[result.outcome], secret),
        "sent_at": _moment(result.sent_at),
        "acknowledged_at": _moment(result.acknowledged_at),
        "proven_at": _moment(result.proven_at),
        "attempts": result.attempts,
    }


def _outcome_members(result: Result | UnitOutcome, message: str, secret: bool) -> OutcomeMembers:
    return {
        "outcome": result.outcome,
        "code": result.outcome,
        "message": message,
        "reason": to_builtins(result.message),
        "read_back": None if secret else result.read_back,
        "unit_error": result.unit_error,
        "unit_error_name": _error_name(result.unit_error),
    }


def _moment(at: float | None) -> str | None:
    return None if at is None else iso(at)


def _error_name(code: int | None) -> str | None:
    return None if code is None else unit_error_name(code)


def _members(body: dict[str, Any]) -> dict[str, Any]:
    """Those that a problem does not have of itself."""
    return {name: value for name, value in body.items() if name not in ("code", "reason")}

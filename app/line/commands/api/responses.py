"""The result of a command as an HTTP response, with its schema."""

from __future__ import annotations

from typing import Annotated, Any, NotRequired

from fastapi import Query
from pydantic import Field
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from typing_extensions import TypeAliasType, TypedDict

from app.core.web.problems import respond
from app.core.web.shape import (
    Instant,
    MaybeInstant,
    MessageShown,
    ReasonShown,
    iso,
    message_shown,
    reason_shown,
)
from app.errors import Problem
from app.line.commands.review import outcome_message
from app.line.live.bus_live import BusLive
from bus.contract import Direction, Frame, Outcome, Result, UnitOutcome
from bus.errors import unit_error_name
from bus.instants import UnixTime

OutcomeShown = TypeAliasType("OutcomeShown", Outcome)
"""Has a name so that clients get a single enumeration of it."""
Moment = Annotated[MaybeInstant, Field(description="ISO 8601 in UTC, milliseconds; null: it did not happen.")]
Attempts = Annotated[int, Field(description="How often the request was sent.")]


class FrameShown(TypedDict):
    """One frame as it passed the port."""

    at: Annotated[Instant, Field(description="ISO 8601 in UTC, milliseconds.")]
    direction: Annotated[Direction, Field(description="out: a request, in: a response.")]
    hex: Annotated[str, Field(description="The bytes on the wire, hexadecimal, separated by blanks.")]
    meaning: Annotated[str, Field(description="Its meaning, English.")]
    meanings: Annotated[list[MessageShown], Field(description="meaning as data.")]
    valid: Annotated[bool, Field(description="Whether it is a complete frame with the right checksum.")]


class OutcomeMembers(ReasonShown):
    """What became of a command, or of its part at one unit."""

    outcome: OutcomeShown
    read_back: Annotated[
        int | None,
        Field(description="Raw value that the unit was read to have; null: not read, or a secret."),
    ]
    unit_error: Annotated[int | None, Field(description="Error code of a NAK, 128 to 137; null: no NAK.")]
    unit_error_name: str | None


class UnitResult(OutcomeMembers):
    """The outcome at one unit, with the times of its frames."""

    unit: Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")]
    sent_at: Moment
    acknowledged_at: Moment
    proven_at: Moment
    attempts: Attempts


class CommandResult(OutcomeMembers):
    """The one outcome of a command; where it is about one unit, also that unit's times."""

    code: Annotated[OutcomeShown, Field(description="As outcome; problems have it too.")]
    id: Annotated[str, Field(description="Of the command: the Idempotency-Key where one was sent.")]
    at: Annotated[Instant, Field(description="When the outcome was known, ISO 8601 in UTC, milliseconds.")]
    bus: str
    unit: Annotated[int | None, Field(description="Address of the one unit it is about; null: several.")]
    skew_s: Annotated[
        float | None,
        Field(
            description="Longest time between the first and the last unit's acting on one broadcast, seconds."
        ),
    ]
    units: Annotated[
        dict[str, UnitResult],
        Field(description="The outcome at each unit of a command to several, by its address."),
    ]
    frames: NotRequired[
        Annotated[
            list[FrameShown],
            Field(description="With frames=true: what carried the command; empty for a secret."),
        ]
    ]
    sent_at: NotRequired[Moment]
    acknowledged_at: NotRequired[Moment]
    proven_at: NotRequired[Moment]
    attempts: NotRequired[Attempts]


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
"""The members that a problem has anyway."""


def command_response(
    request: Request, bus: BusLive, result: Result, unit: int | None = None, *, frames: bool = False
) -> Response:
    """Return 200 with the result, or the problem that it stands for; both have the same members. ``frames``:
    with the frames that carried the command."""
    body = result_json(bus, result, unit)
    if frames:
        body["frames"] = [frame_json(frame) for frame in result.frames]
    status = STATUS[result.outcome]
    if status == 200:
        return JSONResponse(body)
    members = {name: value for name, value in body.items() if name not in _OF_A_PROBLEM}
    return respond(request, Problem(status, result.outcome, outcome_message(result), **members))


def result_json(bus: BusLive, result: Result, unit: int | None = None) -> dict[str, Any]:
    """Return a result as JSON: in ``units`` the result at each of several, by its number as text; for a
    command to one ``unit`` the members of its result."""
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


def frame_json(frame: Frame) -> FrameShown:
    """Return one frame as it passed the port."""
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

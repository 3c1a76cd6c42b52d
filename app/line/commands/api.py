"""The commands over HTTP, and the result of each with its schema. Each request ends once its result is known;
its body is parsed strictly."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Any, NotRequired

from fastapi import APIRouter, Depends, Query
from pydantic import Field, StringConstraints, model_validator
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from typing_extensions import TypeAliasType, TypedDict

from app.core.web.access import Person, Requires
from app.core.web.api import ApiRoute, RequestKey, problems
from app.core.web.arrival import Deadline, made_at
from app.core.web.problems import respond
from app.core.web.services import bus_service, bus_service_of
from app.core.web.shape import (
    Instant,
    MaybeInstant,
    MessageShown,
    ReasonShown,
    StrictBody,
    iso,
    message_shown,
    reason_shown,
)
from app.errors import Problem
from app.line.commands.catalogue import (
    CHANGE_BAUD,
    EXECUTE_ALL,
    EXECUTE_SPEED,
    READ_PARAMETERS,
    SET_LINE,
    SET_SPEED,
    WRITE_ANALOG_OUTPUT,
    WRITE_OUTPUT,
    WRITE_PARAMETER,
    CommandKind,
    timeout_s_for,
)
from app.line.commands.review import outcome_message
from app.line.commands.service import CommandService, RequiresWrite, check_all_read
from app.line.commands.values import Scales
from app.line.live.api.view import ParameterShown, parameter_json
from app.line.live.bus_live import BusLive, UnitLive
from app.line.live.requests import unit_of_bus_or_404
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.values import OUTPUT_NUMBERS
from bus.contract import (
    Action,
    ChangeBaud,
    Direction,
    ExecuteAll,
    ExecuteSpeed,
    Frame,
    Outcome,
    ReadParameters,
    Result,
    SetLine,
    SetSpeed,
    UnitOutcome,
    UnitScale,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.errors import unit_error_name
from bus.instants import Monotonic, UnixTime
from bus.messages import Message

OutcomeShown = TypeAliasType("OutcomeShown", Outcome)
"""Has a name so that clients get a single enumeration of it."""
Moment = Annotated[MaybeInstant, Field(description="ISO 8601 in UTC, milliseconds; null: it did not happen.")]
Attempts = Annotated[int, Field(description="How often the request was sent.")]


class FrameShown(TypedDict):
    """A frame as it passed the port."""

    at: Annotated[Instant, Field(description="ISO 8601 in UTC, milliseconds.")]
    direction: Annotated[Direction, Field(description="out: a request, in: a response.")]
    hex: Annotated[str, Field(description="The bytes on the wire, hexadecimal, separated by blanks.")]
    meaning: Annotated[str, Field(description="Its meaning, English.")]
    meanings: Annotated[list[MessageShown], Field(description="meaning as data.")]
    valid: Annotated[bool, Field(description="Whether it is a complete frame with the right checksum.")]


class OutcomeMembers(ReasonShown):
    """The outcome of a command, or of its part at one unit."""

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
    """The one outcome of a command; if it is about one unit, also that unit's times."""

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
"""The members that every problem has."""


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


router = APIRouter(prefix="/api/v1/buses/{bus}", tags=["commands"], route_class=ApiRoute)
FIRST_READ_WITHIN_S = 5.0
"""The seconds that a request waits for parameters that were never read; the reading itself goes on."""
RESULT_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"model": CommandResult, "description": "verified or acknowledged"},
    **problems(404, 409, 423, 504),
}

BusInPath = Annotated[BusLive, bus_service(BusLive)]


async def _unit_in_path(bus: BusInPath, unit: int) -> UnitLive:
    return unit_of_bus_or_404(bus, unit)


UnitInPath = Annotated[UnitLive, Depends(_unit_in_path)]


TimeoutS = Annotated[float, Field(ge=0.05, le=30)]
"""The seconds that a write may wait for the wire; after that it is dropped."""
UnitKey = Annotated[str, StringConstraints(pattern=r"^[1-9][0-9]{0,2}$")]
TypedValue = str | int | float


class CommandRequestBody(StrictBody):
    """The members that the body of every command may have."""

    timeout_s: Annotated[
        TimeoutS | None, Field(description="Time that it may wait for the wire, 0.05 to 30 s; else 2 s.")
    ] = None
    confirm: Annotated[bool, Field(description="Confirms a dangerous value or a large step.")] = False


class Quantity(StrictBody):
    """A raw integer of the wire, or the value as displayed; not both."""

    raw: Annotated[int | None, Field(description="Integer on the wire, 0 to 99999.")] = None
    value: Annotated[
        TypedValue | None,
        Field(description="As the unit displays it, such as 1234.5; of a setpoint also 105 % of its own."),
    ] = None

    @model_validator(mode="after")
    def _is_given_once(self) -> Quantity:
        if (self.raw is None) == (self.value is None):
            raise ValueError(Message("raw_or_value"))
        if isinstance(self.value, bool):
            raise ValueError(Message("value_not_a_number"))
        return self

    @property
    def typed(self) -> str:
        """The value as a person would type it; empty if ``raw`` is given."""
        if isinstance(self.value, float):
            return f"{Decimal(repr(self.value)).normalize():f}"
        return "" if self.value is None else str(self.value)


class SpeedRequest(CommandRequestBody, Quantity):
    """A setpoint. ``execute`` true: 84h, immediately; false: 82h, staged until executed."""

    execute: bool = True


class ParameterRequest(CommandRequestBody, Quantity):
    """The new value of a parameter."""


class OutputRequest(CommandRequestBody):
    """The requested state of an auxiliary output."""

    on: bool


class BaudRequest(CommandRequestBody):
    """The new baud rate of every unit of a bus (#18)."""

    baud: Annotated[int, Field(description="300, 600, 1200, 2400, 4800 or 9600 bit/s.")]


class AnalogOutputRequest(CommandRequestBody):
    """A value for the analog output (88h)."""

    raw: Annotated[int, Field(description="Integer on the wire, #29 (0 V) to #30 (10 V).")]


class SpeedsRequest(CommandRequestBody):
    """The setpoints of one change, by unit."""

    setpoints: Annotated[dict[UnitKey, Quantity], Field(min_length=1)]


@dataclass(frozen=True, slots=True)
class CommandCall:
    """The request of a command beside its body: its sender, the key, and when it was made."""

    request: Request
    person: Person
    bus: BusLive
    commands: CommandService
    key: str | None
    made_at: Monotonic
    query_timeout_s: float | None
    frames: bool

    def deadline(self, body: CommandRequestBody, staged_units: int = 0, *, typed: bool = False) -> Deadline:
        """Return the deadline by the body's ``timeout_s``, else the query's, else the usual time of the
        change."""
        given = body.timeout_s if body.timeout_s is not None else self.query_timeout_s
        usual = timeout_s_for(self.bus, staged_units, typed=typed)
        return Deadline(self.made_at, usual if given is None else given)

    async def setpoint(self, unit: int, given: Quantity, deadline: Deadline) -> tuple[int, Scales]:
        """Return the raw setpoint of a unit, and its scale. Raise Problem 404."""
        unit_of_bus_or_404(self.bus, unit)
        if given.raw is not None:
            return given.raw, {}
        raw, scale = await self.commands.convert_setpoint(self.person, unit, given.typed, deadline)
        return raw, {unit: scale}

    async def send(
        self,
        action: Action,
        body: CommandRequestBody,
        unit: int | None = None,
        deadline: Deadline | None = None,
        scales: Scales | None = None,
    ) -> Response:
        """Send ``action`` and return its result as a response. ``scales``: those of its values, unless they
        were given raw."""
        deadline = deadline or self.deadline(body)
        result = await self.commands.send(
            self.person, action, deadline=deadline, confirm=body.confirm, id=self.key, scales=scales or None
        )
        return command_response(self.request, self.bus, result, unit, frames=self.frames)


QueryTimeoutS = Annotated[float | None, Query(ge=0.05, le=30)]


class _ReadCall(Requires):
    """A dependency that returns the call of a user who may read parameters.

    It also grants the right and looks up the services: a dependency of its own for each would cost more.
    """

    async def __call__(  # type: ignore[override]
        self, request: Request, bus: str, timeout_s: QueryTimeoutS = None, key: RequestKey = None
    ) -> CommandCall:
        return await _call(self, request, bus, timeout_s, key)


class _WriteCall(RequiresWrite):
    """The dependency that does so for a user who may send a kind of command that writes."""

    async def __call__(  # type: ignore[override]
        self,
        request: Request,
        bus: str,
        timeout_s: QueryTimeoutS = None,
        key: RequestKey = None,
        frames: FramesWanted = False,
    ) -> CommandCall:
        return await _call(self, request, bus, timeout_s, key, frames=frames)


async def _call(
    grant: Requires,
    request: Request,
    bus: str,
    timeout_s: float | None,
    key: str | None,
    *,
    frames: bool = False,
) -> CommandCall:
    person = await grant.granted_once(request)
    live = bus_service_of(request, bus, BusLive)
    commands = bus_service_of(request, bus, CommandService)
    return CommandCall(request, person, live, commands, key, made_at(request), timeout_s, frames)


def calling(kind: CommandKind[Any]) -> Any:
    """Make a dependency that returns the call of a user with the role of a kind of command."""
    called = _WriteCall if kind.request.writes else _ReadCall
    return Depends(called(kind.role, kind.request.__name__))


@router.post("/units/{unit:int}/speed", responses=RESULT_RESPONSES)
async def set_speed(
    call: Annotated[CommandCall, calling(SET_SPEED)], unit: int, body: SpeedRequest
) -> Response:
    """Send 84h (``execute``) or 82h. Staging is acknowledged; executing is verified by 81h."""
    deadline = call.deadline(body)
    raw, scales = await call.setpoint(unit, body, deadline)
    action = SetSpeed(unit=unit, raw=raw, execute=body.execute)
    return await call.send(action, body, unit, deadline, scales)


@router.post("/units/{unit:int}/execute", responses=RESULT_RESPONSES)
async def execute_speed(
    call: Annotated[CommandCall, calling(EXECUTE_SPEED)], unit: int, body: CommandRequestBody | None = None
) -> Response:
    """Send 83h to one unit: its staged speed becomes its commanded speed."""
    return await call.send(ExecuteSpeed(unit=unit), body or CommandRequestBody(), unit)


@router.post("/execute", responses=RESULT_RESPONSES)
async def execute_all_speeds(
    call: Annotated[CommandCall, calling(EXECUTE_ALL)], body: CommandRequestBody | None = None
) -> Response:
    """Send 83h to all units and read each back."""
    return await call.send(ExecuteAll(), body or CommandRequestBody())


@router.post("/speeds", responses=RESULT_RESPONSES)
async def set_speeds(call: Annotated[CommandCall, calling(SET_LINE)], body: SpeedsRequest) -> Response:
    """Stage all, require every acknowledgement, broadcast, read back: all units change or none."""
    typed = any(quantity.raw is None for quantity in body.setpoints.values())
    deadline = call.deadline(body, len(body.setpoints), typed=typed)
    setpoints: dict[int, int] = {}
    scales: dict[int, UnitScale] = {}
    for key, quantity in body.setpoints.items():
        setpoints[int(key)], scale = await call.setpoint(int(key), quantity, deadline)
        scales |= scale
    return await call.send(SetLine(setpoints=setpoints), body, deadline=deadline, scales=scales)


@router.put("/units/{unit:int}/outputs/{number:int}", responses=RESULT_RESPONSES)
async def write_output(
    call: Annotated[CommandCall, calling(WRITE_OUTPUT)], unit: int, number: int, body: OutputRequest
) -> Response:
    """Send 87h, verified by the bit in ST2."""
    unit_of_bus_or_404(call.bus, unit)
    if number not in OUTPUT_NUMBERS:
        raise Problem(404, "unknown_output", Message("no_such_output"), unit=unit)
    return await call.send(WriteOutput(unit=unit, number=number, on=body.on), body, unit)


@router.put("/units/{unit:int}/analog-output", responses=RESULT_RESPONSES)
async def write_analog_output(
    call: Annotated[CommandCall, calling(WRITE_ANALOG_OUTPUT)], unit: int, body: AnalogOutputRequest
) -> Response:
    """Send 88h. The best outcome is acknowledged, because nothing can be read back."""
    return await call.send(WriteAnalogOutput(unit=unit, raw=body.raw), body, unit)


@router.post("/baud", responses=RESULT_RESPONSES)
async def change_baud(call: Annotated[CommandCall, calling(CHANGE_BAUD)], body: BaudRequest) -> Response:
    """Change #18 of every unit, then of the host; each unit is read back. All are set back if one is lost."""
    return await call.send(ChangeBaud(baud=body.baud), body)


@router.get("/units/{unit:int}/parameters", response_model=list[ParameterShown], responses=problems(504))
async def get_parameters(
    call: Annotated[CommandCall, calling(READ_PARAMETERS)],
    unit: int,
    refresh: bool = False,
    gaps: bool = False,
) -> list[dict[str, Any]]:
    """List all 40 parameters as last read, or with ``refresh`` read now. #21 is masked. With ``gaps`` only
    the gaps of the scan are used: slower, and polling keeps its rate. A parameter that was never read is read
    now if the unit responds."""
    found = unit_of_bus_or_404(call.bus, unit)
    if refresh:
        await _read(call, unit, list(PARAMETERS), gaps=gaps)
    elif never_read := [number for number in PARAMETERS if number not in found.parameters]:
        with suppress(Problem, TimeoutError):
            async with asyncio.timeout(FIRST_READ_WITHIN_S):
                await _read(call, unit, never_read, gaps=gaps)
    return [parameter_json(found, number) for number in PARAMETERS]


async def _read(call: CommandCall, unit: int, numbers: list[int], *, gaps: bool) -> None:
    """Read parameters from the unit. Raise Problem 503 or 504 if not all of them come."""
    action = ReadParameters(unit=unit, numbers=numbers, urgent=not gaps)
    result = await call.commands.send(call.person, action)
    check_all_read(unit, numbers, result)


@router.put("/units/{unit:int}/parameters/{number:int}", responses=RESULT_RESPONSES)
async def write_parameter(
    call: Annotated[CommandCall, calling(WRITE_PARAMETER)], unit: int, number: int, body: ParameterRequest
) -> Response:
    """Send 86h, read back with 85h. A parameter that can interrupt the link needs ``confirm``."""
    deadline = call.deadline(body)
    unit_of_bus_or_404(call.bus, unit)
    if number not in PARAMETERS:
        raise Problem(404, "unknown_parameter", Message("no_such_parameter"), unit=unit)
    raw, scales = body.raw, None
    if raw is None:
        raw, scale = await call.commands.convert_parameter(call.person, unit, number, body.typed, deadline)
        scales = {unit: scale}
    action = WriteParameter(unit=unit, number=number, raw=raw)
    return await call.send(action, body, unit, deadline, scales)

"""A write to one unit, from the frame to its one outcome. Pure (``bus.line.commands.procedure``)."""

from __future__ import annotations

from collections.abc import Callable

from bus.contract import Outcome, UnitOutcome
from bus.errors import unit_error, unit_refused
from bus.line.commands.procedure import CommandContext, Procedure, ProcedureResult, ReportProgress, send
from bus.line.commands.readback import (
    REREADS,
    Readback,
    Verification,
    verify_output,
    verify_parameter,
    verify_speed,
)
from bus.line.exchange.send import Send, SendResult, SendStatus
from bus.line.roster import UnitRecord
from bus.messages import Message
from bus.wire.commands import (
    ExecuteSpeedRequest,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    WriteAnalogOutputRequest,
    WriteOutputRequest,
    WriteParameterRequest,
)


def set_and_execute(record: UnitRecord, raw: int, context: CommandContext) -> Procedure:
    """84h, verified by the commanded speed of an 81h."""
    before = record.commanded
    return write(
        record.unit,
        SetAndExecuteSpeedRequest(record.unit, raw),
        lambda: verify_speed(record, raw, context.dialect, before=before),
    )


def stage(record: UnitRecord, raw: int) -> Procedure:
    """82h: not visible until it is executed, so acknowledged at best."""
    return write(record.unit, StageSpeedRequest(record.unit, raw), None)


def execute(record: UnitRecord, context: CommandContext) -> Procedure:
    """83h to one unit, verified where its staged value is known."""
    staged, before = record.staged, record.commanded
    request = ExecuteSpeedRequest(record.unit)
    if staged is None:
        return write(record.unit, request, None)
    return write(record.unit, request, lambda: verify_speed(record, staged, context.dialect, before=before))


def write_parameter(unit: int, number: int, raw: int) -> Procedure:
    """86h, verified by 85h."""
    return write(unit, WriteParameterRequest(unit, number, raw), lambda: verify_parameter(unit, number, raw))


def write_output(unit: int, number: int, on: bool) -> Procedure:
    """87h, verified by the bit in ST2."""
    return write(unit, WriteOutputRequest(unit, number, on), lambda: verify_output(unit, number, on))


def write_analog_output(unit: int, raw: int) -> Procedure:
    """88h: nothing can be read back."""
    return write(unit, WriteAnalogOutputRequest(unit, raw), None)


def write(unit: int, request: Request, verify: Callable[[], Verification] | None) -> Procedure:
    """Send ``request`` and, unless refused, read it back. ``verify`` None: there is only the ACK."""
    sent = yield from send(Send(request, reports_sent=True))
    if not sent.may_have_acted:
        return result_of_one(outcome_without_readback(unit, sent))
    if sent.status is SendStatus.RESPONDED and sent.refusal is None:
        yield ReportProgress("acknowledged", unit)
    if verify is None:
        return result_of_one(outcome_without_readback(unit, sent))
    yield ReportProgress("proving", unit)
    readback = yield from verify()
    return result_of_one(outcome_with_readback(unit, sent, readback))


def outcome_without_readback(unit: int, sent: SendResult) -> UnitOutcome:
    """Return the outcome of a write that is not, or cannot be, read back."""
    outcome, message = _outcome_without_readback(unit, sent)
    return UnitOutcome(
        unit=unit,
        outcome=outcome,
        message=message,
        unit_error=sent.refusal,
        sent_at=sent.sent_at,
        acknowledged_at=sent.responded_at if sent.refusal is None else None,
        attempts=sent.attempts,
    )


def _outcome_without_readback(unit: int, sent: SendResult) -> tuple[Outcome, Message]:
    if sent.refusal is not None:
        refusal = unit_refused(unit, sent.refusal)
        if sent.may_have_acted:
            return "unverified", Message.of("unit_refused_retry", refusal=refusal)
        return "refused", refusal
    if sent.status is SendStatus.RESPONDED:
        return "acknowledged", Message("nothing_to_read_back")
    if sent.attempts == 0:
        return not_sent(unit, sent)
    return "unverified", Message.of("write_unacknowledged", unit=unit, n=sent.attempts)


def not_sent(unit: int, sent: SendResult) -> tuple[Outcome, Message]:
    """Why nothing left for ``unit``."""
    if sent.status is SendStatus.PORT_CLOSED:
        return "bus_closed", Message("bus_not_linked")
    if sent.status is SendStatus.TOO_LATE:
        return "not_sent", Message("deadline_passed")
    return "unverified", Message.of("unit_unresponsive", unit=unit)


def outcome_with_readback(unit: int, sent: SendResult, readback: Readback) -> UnitOutcome:
    """Return the outcome of a write that was read back."""
    refused = sent.refusal is not None and not readback.shown and readback.read_back is not None
    unproven: Outcome = "refused" if refused else "unverified"
    return UnitOutcome(
        unit=unit,
        outcome="verified" if readback.shown else unproven,
        message=_message_of(unit, sent, readback),
        unit_error=sent.refusal if refused else None,
        read_back=readback.read_back,
        sent_at=sent.sent_at,
        acknowledged_at=sent.responded_at if sent.refusal is None else None,
        proven_at=readback.at if readback.shown else None,
        attempts=sent.attempts,
    )


def _message_of(unit: int, sent: SendResult, readback: Readback) -> Message | None:
    acknowledged = sent.status is SendStatus.RESPONDED and sent.refusal is None
    if readback.shown:
        return None if acknowledged else Message("verified_unacknowledged")
    response = Message("response_acknowledged" if acknowledged else "response_missing")
    if sent.refusal is not None:
        response = Message.of("response_refused", error=unit_error(sent.refusal))
    assert readback.why is not None
    if readback.read_back is None:
        return Message.of("readback_missing", unit=unit, response=response, reason=readback.why)
    return Message.of(
        "readback_differs", unit=unit, response=response, reason=readback.why, reads=1 + REREADS
    )


def result_of_one(outcome: UnitOutcome) -> ProcedureResult:
    return ProcedureResult(
        outcome=outcome.outcome,
        message=outcome.message,
        unit_error=outcome.unit_error,
        read_back=outcome.read_back,
        units=(outcome,),
    )

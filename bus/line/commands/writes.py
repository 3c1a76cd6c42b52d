"""A write to one unit, from the frame to its one outcome. Pure (``bus.line.commands.procedure``)."""

from __future__ import annotations

from typing import TypeAlias

from msgspec.structs import replace

from bus.catalogue.numbers import FOLLOWER_MODE
from bus.catalogue.status import status_bits
from bus.catalogue.values import is_follower
from bus.contract import (
    ExecuteSpeed,
    Outcome,
    SetSpeed,
    UnitOutcome,
    UnitScale,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.errors import unit_error, unit_refused
from bus.line.commands.procedure import (
    CommandContext,
    NoteStagedScale,
    Procedure,
    ProcedureResult,
    ReportProgress,
    Subprocedure,
    Unstage,
    send,
)
from bus.line.commands.readback import (
    REREADS,
    Readback,
    ScaleReading,
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

UnitWrite: TypeAlias = SetSpeed | ExecuteSpeed | WriteOutput | WriteAnalogOutput | WriteParameter


def write_to_unit(record: UnitRecord, action: UnitWrite, context: CommandContext) -> Procedure:
    """Send ``action`` to its unit and prove it, where a later exchange can show it.

    The scale of a typed value is read before it is sent and again afterwards, and the value is not verified
    in another one. That of a raw value is read afterwards alone, so that the record shows it as the unit
    does. One parameter is read between the acknowledgement and an 81h that proves the write: there it needs
    no fence, which the next one does (``bus.wire.fence``).
    """
    unit, scale, guarded = record.unit, context.scale(record.unit), context.typed
    if isinstance(action, ExecuteSpeed):
        if record.staged_unknown:
            return ProcedureResult("refused", Message.of("staged_unknown", unit=unit))
        scale, guarded = {**scale, **record.staged_scale}, guarded or bool(record.staged_scale)
    before = ScaleReading(unit, scale if guarded else {})
    yield from before.read_all()
    if before.difference is not None:
        return _result_of_one(outcome_before_write(unit, before.difference))
    after = ScaleReading(unit, scale if guarded else dict(reversed(scale.items())))
    outcome = yield from _write_unscaled(record, action, context, after)
    if isinstance(action, SetSpeed) and not action.execute and outcome.outcome == "acknowledged" and guarded:
        yield NoteStagedScale(unit, scale)
    if isinstance(action, SetSpeed | ExecuteSpeed) and outcome.outcome == "verified":
        yield Unstage(unit)  # also where its acknowledgement was lost
    if not guarded and _shows_mode(record, scale, outcome):
        after.remaining.pop(FOLLOWER_MODE, None)
    if outcome.outcome in SUCCEEDED:
        yield from after.read_all()
    return _result_of_one(outcome_in_scale(outcome, after, guarded=guarded))


SUCCEEDED = ("verified", "acknowledged")


def _shows_mode(record: UnitRecord, scale: UnitScale, outcome: UnitOutcome) -> bool:
    """Return whether the 81h that proved a write also shows the mode (#8) of ``scale``, by its status bit."""
    reading = record.reading
    if reading is None or reading.at != outcome.proven_at:
        return False
    return status_bits(reading.outputs, reading.inputs).follower == is_follower(scale.get(FOLLOWER_MODE))


def outcome_before_write(unit: int, difference: tuple[Outcome, Message]) -> UnitOutcome:
    """Return the outcome at a unit that is not written, as its scale is another or cannot be read."""
    outcome, reason = difference
    return UnitOutcome(unit, outcome, Message.of("scale_changed_nothing_sent", reason=reason))


def outcome_in_scale(outcome: UnitOutcome, after: ScaleReading, *, guarded: bool) -> UnitOutcome:
    """Return ``outcome``, or *unverified* where the unit shows a typed value (``guarded``) in another scale
    by now: what it shows is then not what was typed."""
    if outcome.outcome not in SUCCEEDED or not guarded or after.difference is None:
        return outcome
    message = Message.of("scale_changed_since", reason=after.difference[1])
    return replace(outcome, outcome="unverified", message=message, proven_at=None)


def _write_unscaled(
    record: UnitRecord, action: UnitWrite, context: CommandContext, scale: ScaleReading
) -> Subprocedure[UnitOutcome]:
    unit, before, dialect = record.unit, record.commanded, context.dialect
    match action:
        case SetSpeed(raw=raw, execute=True):
            readback = verify_speed(record, raw, dialect, before=before)
            return _write(SetAndExecuteSpeedRequest(unit, raw), readback, scale)
        case SetSpeed(raw=raw):  # Not visible until it is executed.
            return _write(StageSpeedRequest(unit, raw), None)
        case ExecuteSpeed():
            staged = record.staged
            known = None if staged is None else verify_speed(record, staged, dialect, before=before)
            return _write(ExecuteSpeedRequest(unit), known, scale)
        case WriteParameter(number=number, raw=raw):
            readback = verify_parameter(unit, number, raw)
            return _write(WriteParameterRequest(unit, number, raw), readback)
        case WriteOutput(number=number, on=on):
            return _write(WriteOutputRequest(unit, number, on), verify_output(unit, number, on))
        case WriteAnalogOutput(raw=raw):
            return _write(WriteAnalogOutputRequest(unit, raw), None)


def _write(
    request: Request, verification: Verification | None, scale: ScaleReading | None = None
) -> Subprocedure[UnitOutcome]:
    """Send ``request`` and, unless refused, read it back. ``verification`` None: there is only the ACK.
    ``scale``: one parameter of it is read before an 81h."""
    unit = request.unit
    sent = yield from send(Send(request, reports_sent=True))
    if not sent.may_have_acted:
        return outcome_without_readback(unit, sent)
    if sent.acknowledged:
        yield ReportProgress("acknowledged", unit)
    if verification is None:
        return outcome_without_readback(unit, sent)
    yield ReportProgress("proving", unit)
    if sent.acknowledged and scale is not None:
        yield from scale.read_next()
    readback = yield from verification
    return outcome_with_readback(unit, sent, readback)


def outcome_of(unit: int, sent: SendResult, outcome: Outcome, message: Message | None) -> UnitOutcome:
    """Return ``outcome`` with the times of the write and of its response."""
    return UnitOutcome(
        unit=unit,
        outcome=outcome,
        message=message,
        unit_error=sent.refusal,
        sent_at=sent.sent_at,
        acknowledged_at=sent.responded_at if sent.refusal is None else None,
        attempts=sent.attempts,
    )


def outcome_without_readback(unit: int, sent: SendResult) -> UnitOutcome:
    """Return the outcome of a write that is not, or cannot be, read back."""
    if sent.refusal is not None:
        refusal = unit_refused(unit, sent.refusal)
        if sent.may_have_acted:
            return outcome_of(unit, sent, "unverified", Message.of("unit_refused_retry", refusal=refusal))
        return outcome_of(unit, sent, "refused", refusal)
    if sent.acknowledged:
        return outcome_of(unit, sent, "acknowledged", Message("nothing_to_read_back"))
    if sent.attempts == 0:
        return outcome_of(unit, sent, *not_sent(unit, sent))
    message = Message.of("write_unacknowledged", unit=unit, n=sent.attempts)
    return outcome_of(unit, sent, "unverified", message)


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
    outcome = outcome_of(
        unit, sent, "verified" if readback.shown else unproven, _remark(unit, sent, readback)
    )
    return replace(
        outcome,
        unit_error=sent.refusal if refused else None,
        read_back=readback.read_back,
        proven_at=readback.at if readback.shown else None,
    )


def _remark(unit: int, sent: SendResult, readback: Readback) -> Message | None:
    """What the readback of a write leaves open; None where nothing."""
    if readback.shown:
        return None if sent.acknowledged else Message("verified_unacknowledged")
    response = Message("response_acknowledged" if sent.acknowledged else "response_missing")
    if sent.refusal is not None:
        response = Message.of("response_refused", error=unit_error(sent.refusal))
    assert readback.why is not None
    if readback.read_back is None:
        return Message.of("readback_missing", unit=unit, response=response, reason=readback.why)
    return Message.of(
        "readback_differs", unit=unit, response=response, reason=readback.why, reads=1 + REREADS
    )


def _result_of_one(outcome: UnitOutcome) -> ProcedureResult:
    return ProcedureResult(
        outcome=outcome.outcome,
        message=outcome.message,
        unit_error=outcome.unit_error,
        read_back=outcome.read_back,
        units=[outcome],
    )

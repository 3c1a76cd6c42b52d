"""A write to one unit, from the frame to its one fate. Pure procedures (``bus.line.commands.procedure``)."""

from __future__ import annotations

from collections.abc import Callable

from bus.contract import Outcome, Result, UnitOutcome
from bus.errors import unit_error, unit_refused
from bus.line.commands.procedure import Answer, Ask, Fate, Procedure, Tell, Wish
from bus.line.commands.readback import (
    LOOKS_AGAIN,
    Proof,
    Proving,
    ask,
    prove_output,
    prove_parameter,
    prove_speed,
)
from bus.line.roster import UnitRecord
from bus.messages import Message
from bus.wire.commands import (
    ExecuteSpeed,
    Request,
    SetAndExecuteSpeed,
    StageSpeed,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)


def set_and_execute(record: UnitRecord, raw: int, wish: Wish) -> Procedure:
    """84h, proven by the commanded speed of an 81h."""
    before = record.reading.commanded if record.reading is not None else None
    return write(
        record.unit,
        SetAndExecuteSpeed(record.unit, raw),
        lambda: prove_speed(record, raw, wish.dialect, before=before),
    )


def stage(record: UnitRecord, raw: int) -> Procedure:
    """82h: not visible until it is executed, so acknowledged at best."""
    return write(record.unit, StageSpeed(record.unit, raw), None)


def execute(record: UnitRecord, wish: Wish) -> Procedure:
    """83h to one unit, proven where it is known what it holds staged."""
    staged = record.staged
    before = record.reading.commanded if record.reading is not None else None
    if staged is None:
        return write(record.unit, ExecuteSpeed(record.unit), None)
    return write(
        record.unit,
        ExecuteSpeed(record.unit),
        lambda: prove_speed(record, staged, wish.dialect, before=before),
    )


def write_parameter(unit: int, number: int, raw: int) -> Procedure:
    """86h, proven by 85h."""
    return write(unit, WriteParameter(unit, number, raw), lambda: prove_parameter(unit, number, raw))


def write_output(unit: int, number: int, on: bool) -> Procedure:
    """87h, proven by the bit in ST2."""
    return write(unit, WriteOutput(unit, number, on), lambda: prove_output(unit, number, on))


def write_analog_output(unit: int, raw: int) -> Procedure:
    """88h: nothing can be read back."""
    return write(unit, WriteAnalogOutput(unit, raw), None)


def write(unit: int, request: Request, prove: Callable[[], Proving] | None) -> Procedure:
    """Send ``request`` and, unless refused, prove it. ``prove`` None: an ACK is all there is."""
    answer = yield from ask(Ask(request, tells=True))
    if not answer.may_have_acted:
        return result_of_one(without_proof(unit, answer))
    if answer.fate is Fate.ANSWERED and answer.refusal is None:
        yield Tell("acknowledged", unit)
    if prove is None:
        return result_of_one(without_proof(unit, answer))
    yield Tell("proving", unit)
    proof = yield from prove()
    return result_of_one(with_proof(unit, answer, proof))


def without_proof(unit: int, answer: Answer) -> UnitOutcome:
    """The fate of a write that is not, or cannot be, read back."""
    outcome, message = _fate_without_proof(unit, answer)
    return UnitOutcome(
        unit=unit,
        outcome=outcome,
        message=message,
        unit_error=answer.refusal,
        sent_at=answer.sent_at,
        acknowledged_at=answer.answered_at if answer.refusal is None else None,
        attempts=answer.attempts,
    )


def _fate_without_proof(unit: int, answer: Answer) -> tuple[Outcome, Message]:
    if answer.refusal is not None:
        refusal = unit_refused(unit, answer.refusal)
        if answer.may_have_acted:
            return "unverified", Message.of("unit_refused_retry", refusal=refusal)
        return "refused", refusal
    if answer.fate is Fate.ANSWERED:
        return "acknowledged", Message("nothing_to_read_back")
    if answer.attempts == 0:
        return not_sent(unit, answer)
    return "unverified", Message.of("write_unacknowledged", unit=unit, n=answer.attempts)


def not_sent(unit: int, answer: Answer) -> tuple[Outcome, Message]:
    """Why nothing left for ``unit``."""
    if answer.fate is Fate.CLOSED:
        return "bus_closed", Message("bus_not_linked")
    if answer.fate is Fate.TOO_LATE:
        return "not_sent", Message("deadline_passed")
    return "unverified", Message.of("unit_unresponsive", unit=unit)


def with_proof(unit: int, answer: Answer, proof: Proof) -> UnitOutcome:
    """The fate of a write that was read back."""
    refused = answer.refusal is not None and not proof.shown and proof.read_back is not None
    unproven: Outcome = "refused" if refused else "unverified"
    return UnitOutcome(
        unit=unit,
        outcome="verified" if proof.shown else unproven,
        message=_message_of(unit, answer, proof),
        unit_error=answer.refusal if refused else None,
        read_back=proof.read_back,
        sent_at=answer.sent_at,
        acknowledged_at=answer.answered_at if answer.refusal is None else None,
        proven_at=proof.at if proof.shown else None,
        attempts=answer.attempts,
    )


def _message_of(unit: int, answer: Answer, proof: Proof) -> Message | None:
    acknowledged = answer.fate is Fate.ANSWERED and answer.refusal is None
    if proof.shown:
        return None if acknowledged else Message("verified_unacknowledged")
    response = Message("response_acknowledged" if acknowledged else "response_missing")
    if answer.refusal is not None:
        response = Message.of("response_refused", error=unit_error(answer.refusal))
    assert proof.why is not None
    if proof.read_back is None:
        return Message.of("readback_missing", unit=unit, response=response, reason=proof.why)
    return Message.of(
        "readback_differs", unit=unit, response=response, reason=proof.why, reads=1 + LOOKS_AGAIN
    )


def result_of_one(outcome: UnitOutcome) -> Result:
    """The result of a command to one unit; id, time and frames are the poller's to add."""
    return Result(
        id="",
        at=0.0,
        outcome=outcome.outcome,
        message=outcome.message,
        unit_error=outcome.unit_error,
        read_back=outcome.read_back,
        units=[outcome],
    )

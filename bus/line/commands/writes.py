"""Pure procedures that write to one unit, from the frame to its one outcome
(``bus.line.commands.procedure``).

A write is verified only by what a later exchange shows. The commanded speed (CS) of an 81h is compared with
the request. A follower (#8 = 1 or 2) is given a ratio, and the dialect decides whether its CS is then that
ratio. If CS is a speed, #37 is read; a CS that has become the ratio counts as read-back only if #37 does not
return it. A unit may take a moment to show what it acknowledged, so a read-back that differs is repeated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from msgspec.structs import replace

from bus.catalogue.parameters import FOLLOWER_MODE, PARAMETERS, RATIO_SETPOINT, SPEED_SETPOINT
from bus.catalogue.values import StatusBits, is_follower, output_is_on, status_bits
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
from bus.errors import UnitErrorCode, unit_error, unit_refused
from bus.instants import UnixTime
from bus.line.commands.procedure import (
    CommandContext,
    NoteStagedScale,
    Procedure,
    ProcedureResult,
    ReportProgress,
    Subprocedure,
    Unstage,
    Wait,
    send,
)
from bus.line.roster import UnitRecord
from bus.line.send import Send, SendResult, SendStatus
from bus.messages import Message, parameter_name
from bus.settings import Dialect
from bus.wire.commands import (
    ExecuteSpeedRequest,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    StatusReply,
    WriteAnalogOutputRequest,
    WriteOutputRequest,
    WriteParameterRequest,
)

REREADS = 2
"""The most repeated reads of a unit whose read-back differs."""
REREAD_AFTER_S = 0.1
NO_READBACK = Message("readback_no_response")


@dataclass(frozen=True, slots=True)
class Readback:
    """The result of a read-back. ``read_back``: None if nothing was read. ``why``: the reason if not
    ``shown``."""

    shown: bool
    read_back: int | None = None
    at: UnixTime | None = None
    why: Message | None = None


Verification = Subprocedure[Readback]


def read_status(unit: int) -> Subprocedure[tuple[StatusReply | None, SendResult]]:
    """Send a fresh 81h, whose response cannot be confused with an older one."""
    sent = yield from send(Send(ReadStatusRequest(unit), fresh=True))
    return (sent.reply if isinstance(sent.reply, StatusReply) else None), sent


def read_parameter(unit: int, number: int) -> Subprocedure[tuple[int | None, SendResult]]:
    """Read a parameter by 85h; the value is None if the unit does not have it or does not respond."""
    sent = yield from send(Send(ReadParameterRequest(unit, number), fresh=True))
    return (sent.reply.raw if isinstance(sent.reply, ParameterReply) else None), sent


class ScaleReading:
    """The repeated, one by one compared reading of the parameters with which a unit's value was converted."""

    def __init__(self, unit: int, scale: UnitScale) -> None:
        self.unit = unit
        self.remaining = dict(scale)
        """The expected raw value of each parameter that is still to be read, by number."""
        self._changes: list[str | Message] = []
        self._failure: tuple[Outcome, Message] | None = None

    @property
    def difference(self) -> tuple[Outcome, Message] | None:
        """The outcome of a command of which nothing was sent, and the reason, by the parameters read so far;
        None if they are as expected."""
        if self._failure is None and self._changes:
            return "refused", Message.of("scale_changed", unit=self.unit, changes=self._changes)
        return self._failure

    def read_next(self) -> Subprocedure[None]:
        """Read the next parameter, which is the last if it cannot be read."""
        if not self.remaining:
            return
        number = next(iter(self.remaining))
        expected = self.remaining.pop(number)
        raw, sent = yield from read_parameter(self.unit, number)
        if sent.status is SendStatus.PORT_CLOSED:
            self._failure = "bus_closed", Message("bus_link_lost")
        elif raw is None and sent.refusal != UnitErrorCode.ILLEGAL_PARAMETER_NUMBER:
            message = Message.of("scale_unread", unit=self.unit, number=parameter_name(number))
            if sent.status is SendStatus.TIMED_OUT:
                message = Message.of("unit_no_response", unit=self.unit)
            self._failure = "unverified", message
        elif raw != expected:
            old, new = ("none" if value is None else value for value in (expected, raw))
            change = Message.of("scale_change", number=parameter_name(number), old=old, new=new)
            self._changes.append(change)
        if self._failure is not None:
            self.remaining.clear()

    def read_all(self) -> Subprocedure[None]:
        """Read what remains, even after a difference, so that the next value is converted right."""
        while self.remaining:
            yield from self.read_next()


def follows(record: UnitRecord, bits: StatusBits) -> Subprocedure[bool]:
    """Return whether the unit is a follower: by #8, which is read now if it is unknown or contradicts the
    status bit."""
    mode = record.raw(FOLLOWER_MODE)
    if mode is None or bool(mode) != bits.follower:
        mode, _ = yield from read_parameter(record.unit, FOLLOWER_MODE)
    return bits.follower if mode is None else mode != 0


def _until_shown(look: Callable[[], Subprocedure[Readback | None]]) -> Verification:
    """Call ``look`` until it shows the value or all rereads are used; it returns None without a response."""
    readback = Readback(False)
    for count in range(1 + REREADS):
        if count:
            yield Wait(REREAD_AFTER_S)
        seen = yield from look()
        if seen is None:
            return Readback(False, readback.read_back, readback.at, NO_READBACK)
        readback = seen
        if readback.shown:
            break
    return readback


def verify_speed(record: UnitRecord, raw: int, dialect: Dialect, *, before: int | None) -> Verification:
    """Prove that ``raw`` is now the commanded speed (or ratio). ``before``: the CS read before the write."""

    def look() -> Subprocedure[Readback | None]:
        status, sent = yield from read_status(record.unit)
        if status is None:
            return None
        bits = status_bits(status.outputs, status.inputs, dialect.estop_healthy)
        if dialect.follower_speed == "speed" and (yield from follows(record, bits)):
            return (yield from _verify_ratio(record, raw, status, sent, before))
        if status.commanded == raw:
            return Readback(True, raw, sent.responded_at)
        return Readback(False, status.commanded, sent.responded_at, _speed_reads(status.commanded, bits))

    return (yield from _until_shown(look))


def _speed_reads(commanded: int, bits: StatusBits) -> Message:
    """Return a message with the commanded speed, and the inputs that may override the setpoint."""
    active = [name for name, on in (("preset", bits.preset), ("up", bits.up), ("down", bits.down)) if on]
    inputs: list[str | Message] = [Message(f"status_{name}") for name in active]
    if not bits.remote:
        inputs.append("LOCAL")
    if not inputs:
        return Message.of("speed_reads", value=commanded)
    return Message.of("speed_reads_while", value=commanded, inputs=inputs)


def _verify_ratio(
    record: UnitRecord, raw: int, status: StatusReply, sent: SendResult, before: int | None
) -> Verification:
    ratio, ratio_read = yield from read_parameter(record.unit, RATIO_SETPOINT)
    if ratio == raw:
        return Readback(True, ratio, ratio_read.responded_at)
    if status.commanded == raw and before is not None and before != raw:
        return Readback(True, raw, sent.responded_at)
    if ratio is None:
        return Readback(False, status.commanded, sent.responded_at, Message("ratio_unread"))
    return Readback(False, ratio, ratio_read.responded_at, Message.of("ratio_reads", value=ratio))


def verify_unchanged(record: UnitRecord, before: int | None) -> Verification:
    """Prove that a unit which was not to change still has its commanded speed, ``before``."""
    status, sent = yield from read_status(record.unit)
    if status is None:
        return Readback(False, None, None, NO_READBACK)
    if before is None or status.commanded == before:
        return Readback(True, status.commanded, sent.responded_at)
    why = Message.of("speed_moved", before=before, value=status.commanded)
    return Readback(False, status.commanded, sent.responded_at, why)


def verify_parameter(unit: int, number: int, raw: int) -> Verification:
    """Prove that the unit returns ``raw`` for parameter ``number`` (85h)."""

    def look() -> Subprocedure[Readback | None]:
        shown, sent = yield from read_parameter(unit, number)
        if sent.reply is None:
            return None
        if shown is None:
            why = Message("parameter_unavailable")
        elif PARAMETERS[number].secret:
            why = Message("secret_reads")
        else:
            why = Message.of("parameter_reads", value=shown)
        return Readback(shown == raw, shown, sent.responded_at, why)

    return (yield from _until_shown(look))


def verify_output(unit: int, number: int, on: bool) -> Verification:
    """Prove that the bit of output ``number`` in ST2 shows ``on``."""

    def look() -> Subprocedure[Readback | None]:
        status, sent = yield from read_status(unit)
        if status is None:
            return None
        shown = output_is_on(status.outputs, number)
        why = Message("output_reads_on" if shown else "output_reads_off")
        return Readback(shown == on, int(shown), sent.responded_at, why)

    return (yield from _until_shown(look))


def present_setpoint(record: UnitRecord, dialect: Dialect) -> Subprocedure[int | None]:
    """Return the setpoint that 82h must put into a unit so that a stray execute changes nothing; None if it
    cannot be read.

    This is the commanded speed of a fresh 81h, a follower's ratio if its CS is a speed, and #20 while an
    input overrides the setpoint.
    """
    status, _ = yield from read_status(record.unit)
    if status is None:
        return None
    bits = status_bits(status.outputs, status.inputs, dialect.estop_healthy)
    follower = yield from follows(record, bits)
    if follower and (dialect.follower_speed == "speed" or bits.preset or bits.up or bits.down):
        ratio, _ = yield from read_parameter(record.unit, RATIO_SETPOINT)
        return ratio
    if bits.preset or bits.up or bits.down:
        setpoint, _ = yield from read_parameter(record.unit, SPEED_SETPOINT)
        return setpoint if setpoint is not None else status.commanded
    return status.commanded


UnitWrite: TypeAlias = SetSpeed | ExecuteSpeed | WriteOutput | WriteAnalogOutput | WriteParameter


def write_to_unit(record: UnitRecord, action: UnitWrite, context: CommandContext) -> Procedure:
    """Send ``action`` to its unit and prove it, if a later exchange can show it.

    The scale of a typed value is read before the value is sent and again afterwards; if it has changed, the
    write is not verified. The scale of a raw value is read only afterwards, so that the record shows the
    value as the unit does. One parameter is read between the acknowledgement and the 81h that proves the
    write: in this place it needs no fence, but the next one does (``bus.wire.exchange``).
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
    if isinstance(action, SetSpeed) and not action.execute and outcome.outcome == "acknowledged":
        if (yield from _is_present(record, action.raw, context)):
            yield Unstage(unit)
        elif guarded:
            yield NoteStagedScale(unit, scale)
    if isinstance(action, SetSpeed | ExecuteSpeed) and outcome.outcome == "verified":
        yield Unstage(unit)  # Also if its acknowledgement was lost.
    if not guarded and _shows_mode(record, scale, outcome):
        after.remaining.pop(FOLLOWER_MODE, None)
    if outcome.outcome in SUCCEEDED:
        yield from after.read_all()
    return _result_of_one(outcome_in_scale(outcome, after, guarded=guarded))


def _is_present(record: UnitRecord, raw: int, context: CommandContext) -> Subprocedure[bool]:
    """Return whether a unit already has setpoint ``raw``, so that executing it would change nothing."""
    reading, shows_setpoint = record.reading, True
    if reading is not None:
        bits = status_bits(reading.outputs, reading.inputs, context.dialect.estop_healthy)
        shows_setpoint = not (bits.preset or bits.up or bits.down or bits.follower)
    if shows_setpoint and record.commanded != raw:
        return False
    return (yield from present_setpoint(record, context.dialect)) == raw


SUCCEEDED = ("verified", "acknowledged")


def _shows_mode(record: UnitRecord, scale: UnitScale, outcome: UnitOutcome) -> bool:
    """Return whether the 81h that proved a write also shows the mode (#8) of ``scale`` by its status bit."""
    reading = record.reading
    if reading is None or reading.at != outcome.proven_at:
        return False
    return status_bits(reading.outputs, reading.inputs).follower == is_follower(scale.get(FOLLOWER_MODE))


def outcome_before_write(unit: int, difference: tuple[Outcome, Message]) -> UnitOutcome:
    """Return the outcome at a unit that is not written because its scale has changed or cannot be read."""
    outcome, reason = difference
    code = "scale_changed_nothing_sent" if reason.code == "scale_changed" else "nothing_sent"
    return UnitOutcome(unit, outcome, Message.of(code, reason=reason))


def outcome_in_scale(outcome: UnitOutcome, after: ScaleReading, *, guarded: bool) -> UnitOutcome:
    """Return ``outcome``, or *unverified* if a typed value (``guarded``) is shown in another scale by now:
    the unit then shows something other than what was typed."""
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
        case SetSpeed(raw=raw):  # A staged speed cannot be read until it is executed.
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
    """Send ``request`` and, unless refused, read it back. ``verification``: None if there is only the ACK.
    ``scale``: one of its parameters is read before the 81h."""
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
    """Return the outcome and the reason when nothing was sent to ``unit``."""
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
    """Return what the read-back of a write leaves open, or None."""
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

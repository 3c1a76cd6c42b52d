"""When a write is proven: only by what a later exchange shows. Pure procedures and rules.

The commanded speed of an 81h is compared with what was asked. A follower (#8 = 1 or 2) is given a
ratio, and whether its CS then is that ratio is the dialect's answer: where it is a speed, #37 is read,
and only where a unit does not say it there, a CS that has become the ratio is taken as proof.

A unit may take a moment to show what it acknowledged, so a read-back that differs is read again.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

from bus.catalogue.numbers import FOLLOWER_MODE, RATIO_SETPOINT, SPEED_SETPOINT
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import StatusBits, output_is_on, status_bits
from bus.line.commands.procedure import Answer, Ask, Step, Wait
from bus.line.roster import UnitRecord
from bus.messages import Message
from bus.settings import Dialect
from bus.wire.commands import ParameterReply, ReadParameter, ReadStatus, StatusReply

LOOKS_AGAIN = 2
"""How often a read-back that differs is read again."""
LOOK_AGAIN_AFTER_S = 0.1
NO_READBACK = Message("readback_no_response")


@dataclass(frozen=True, slots=True)
class Proof:
    """What the read-back showed. ``read_back`` None: there was none. ``why``: where not ``shown``."""

    shown: bool
    read_back: int | None = None
    at: float | None = None
    why: Message | None = None


Proving = Generator[Step, Answer | None, Proof]
Asking = Generator[Step, Answer | None, Answer]


def ask(step: Ask) -> Asking:
    """The answer to one Ask."""
    answer = yield step
    assert answer is not None
    return answer


def read_status(unit: int) -> Generator[Step, Answer | None, tuple[StatusReply | None, Answer]]:
    """A fresh 81h that nothing older can be taken for."""
    answer = yield from ask(Ask(ReadStatus(unit), proves=True))
    return (answer.reply if isinstance(answer.reply, StatusReply) else None), answer


def read_parameter(unit: int, number: int) -> Generator[Step, Answer | None, tuple[int | None, Answer]]:
    """A fresh 85h; None when the unit does not have it, or does not answer."""
    answer = yield from ask(Ask(ReadParameter(unit, number), proves=True))
    return (answer.reply.raw if isinstance(answer.reply, ParameterReply) else None), answer


def follows(record: UnitRecord, bits: StatusBits) -> Generator[Step, Answer | None, bool]:
    """Whether the unit is a follower: by #8, read now where it is not known or the status bit disagrees."""
    mode = record.raw(FOLLOWER_MODE)
    if mode is None or bool(mode) != bits.follower:
        mode, _ = yield from read_parameter(record.unit, FOLLOWER_MODE)
    return bits.follower if mode is None else mode != 0


def prove_speed(record: UnitRecord, raw: int, dialect: Dialect, *, before: int | None) -> Proving:
    """That ``raw`` is now the commanded speed (or ratio). ``before``: the CS last read before the write."""
    proof = Proof(False)
    for look in range(1 + LOOKS_AGAIN):
        if look:
            yield Wait(LOOK_AGAIN_AFTER_S)
        status, answer = yield from read_status(record.unit)
        if status is None:
            return Proof(False, proof.read_back, proof.at, NO_READBACK)
        bits = status_bits(status.outputs, status.inputs, dialect.estop_healthy)
        if dialect.follower_speed == "speed" and (yield from follows(record, bits)):
            proof = yield from _prove_ratio(record, raw, status, answer, before)
        else:
            proof = _compare_speed(raw, status, bits, answer)
        if proof.shown:
            return proof
    return proof


def _compare_speed(raw: int, status: StatusReply, bits: StatusBits, answer: Answer) -> Proof:
    if status.commanded == raw:
        return Proof(True, raw, answer.answered_at)
    return Proof(False, status.commanded, answer.answered_at, _speed_reads(status.commanded, bits))


def _speed_reads(commanded: int, bits: StatusBits) -> Message:
    """With what, at the unit's terminals, may stand above the commanded speed."""
    active = [name for name, on in (("preset", bits.preset), ("up", bits.up), ("down", bits.down)) if on]
    inputs: list[int | str | Message] = [Message(f"status_{name}") for name in active]
    if not bits.remote:
        inputs.append("LOCAL")
    if not inputs:
        return Message.of("speed_reads", value=commanded)
    return Message.of("speed_reads_while", value=commanded, inputs=inputs)


def _parameter_reads(number: int, shown: int | None) -> Message:
    if shown is None:
        return Message("parameter_unavailable")
    return (
        Message("secret_reads") if PARAMETERS[number].secret else Message.of("parameter_reads", value=shown)
    )


def _prove_ratio(
    record: UnitRecord, raw: int, status: StatusReply, answer: Answer, before: int | None
) -> Proving:
    ratio, ratio_answer = yield from read_parameter(record.unit, RATIO_SETPOINT)
    if ratio == raw:
        return Proof(True, ratio, ratio_answer.answered_at)
    if status.commanded == raw and before is not None and before != raw:
        return Proof(True, raw, answer.answered_at)
    if ratio is None:
        return Proof(False, status.commanded, answer.answered_at, Message("ratio_unread"))
    return Proof(False, ratio, ratio_answer.answered_at, Message.of("ratio_reads", value=ratio))


def prove_unchanged(record: UnitRecord, before: int | None) -> Proving:
    """That a unit to which nothing was to happen still has the commanded speed it had."""
    status, answer = yield from read_status(record.unit)
    if status is None:
        return Proof(False, None, None, NO_READBACK)
    if before is None or status.commanded == before:
        return Proof(True, status.commanded, answer.answered_at)
    why = Message.of("speed_moved", before=before, value=status.commanded)
    return Proof(False, status.commanded, answer.answered_at, why)


def prove_parameter(unit: int, number: int, raw: int) -> Proving:
    """That 85h shows ``raw``."""
    proof = Proof(False)
    for look in range(1 + LOOKS_AGAIN):
        if look:
            yield Wait(LOOK_AGAIN_AFTER_S)
        shown, answer = yield from read_parameter(unit, number)
        if answer.reply is None:
            return Proof(False, proof.read_back, proof.at, NO_READBACK)
        proof = Proof(shown == raw, shown, answer.answered_at, _parameter_reads(number, shown))
        if proof.shown:
            return proof
    return proof


def prove_output(unit: int, number: int, on: bool) -> Proving:
    """That the bit of output ``number`` in ST2 shows ``on``."""
    proof = Proof(False)
    for look in range(1 + LOOKS_AGAIN):
        if look:
            yield Wait(LOOK_AGAIN_AFTER_S)
        status, answer = yield from read_status(unit)
        if status is None:
            return Proof(False, proof.read_back, proof.at, NO_READBACK)
        shown = output_is_on(status.outputs, number)
        why = Message("output_reads_on" if shown else "output_reads_off")
        proof = Proof(shown == on, int(shown), answer.answered_at, why)
        if proof.shown:
            return proof
    return proof


def present_setpoint(record: UnitRecord, dialect: Dialect) -> Generator[Step, Answer | None, int | None]:
    """What 82h must put into a unit so that a stray execute changes nothing; None when it cannot be read.

    The commanded speed of a fresh 81h; a follower's ratio where CS is a speed; #20 while an input stands
    above the setpoint.
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

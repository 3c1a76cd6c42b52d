"""After the broadcast: what each unit shows, who is told singly, who else has moved. Pure procedures."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence

import msgspec

from bus.contract import Result, UnitOutcome
from bus.line.commands.member import Member
from bus.line.commands.procedure import Answer, Ask, Procedure, Step, Tell, Unstage, Wish
from bus.line.commands.readback import Proof, ask, prove_speed, prove_unchanged
from bus.line.commands.writes import with_proof
from bus.line.roster import Roster
from bus.messages import Message, joined
from bus.wire.commands import ExecuteSpeed

Part = Generator[Step, Answer | None, None]
EXECUTED_SINGLY = Message("executed_singly")


def prove_all(members: list[Member], broadcast: Answer, roster: Roster, wish: Wish) -> Procedure:
    """Each of them, then those that missed it once more, then whoever was not asked to move."""
    for done, member in enumerate(members):
        yield Tell("proving", member.unit, done, len(members))
        yield from prove(member, broadcast, wish)
    for member in members:
        if member.outcome is not None and member.outcome.outcome != "verified":
            yield from _tell_singly(member, wish)
    strays = yield from _strays(roster, members)
    return executed(members, broadcast, strays)


def prove(member: Member, broadcast: Answer, wish: Wish) -> Part:
    """Whether it shows what it had staged."""
    proof = yield from prove_speed(member.record, member.raw, wish.dialect, before=member.before)
    if proof.shown:
        yield Unstage(member.unit)
    outcome = with_proof(member.unit, broadcast, proof)
    staging = member.answer
    member.outcome = msgspec.structs.replace(
        outcome,
        message=None if proof.shown else _not_shown(member, proof),
        sent_at=staging.sent_at if staging is not None else broadcast.sent_at,
        acknowledged_at=staging.answered_at if staging is not None else None,
        attempts=staging.attempts if staging is not None else 1,
    )


def _not_shown(member: Member, proof: Proof) -> Message:
    """Whoever missed the broadcast has the value in its memory, and the next execute would find it there."""
    assert proof.why is not None
    return Message.of("unit_may_hold", unit=member.unit, reason=proof.why, raw=member.raw)


def _tell_singly(member: Member, wish: Wish) -> Part:
    """It acknowledged its stage and does not show it: it may have missed the one frame nobody answers."""
    answer = yield from ask(Ask(ExecuteSpeed(member.unit)))
    if not answer.may_have_acted:
        return
    yield from prove(member, answer, wish)
    if member.outcome is not None and member.outcome.outcome == "verified":
        member.outcome = msgspec.structs.replace(member.outcome, message=EXECUTED_SINGLY)


def _strays(roster: Roster, members: list[Member]) -> Generator[Step, Answer | None, list[Message]]:
    """Which units outside the change moved with it, staged by somebody else."""
    inside = {member.unit for member in members}
    moved: list[Message] = []
    for record in roster:
        if record.unit in inside or not roster.is_configured(record.unit):
            continue
        if record.link.link != "online" or record.reading is None:
            continue
        proof = yield from prove_unchanged(record, record.reading.commanded)
        if proof.why is not None and proof.read_back is not None:
            moved.append(Message.of("outsider_moved", unit=record.unit, reason=proof.why))
    return moved


def unchanged(member: Member, broadcast: Answer, proof: Proof) -> UnitOutcome:
    """The fate of one that had nothing staged from here."""
    if proof.why is None:
        message = Message("unit_unchanged")
    else:
        message = Message.of("unit_remark", unit=member.unit, remark=proof.why)
    outcome = with_proof(member.unit, broadcast, proof)
    return msgspec.structs.replace(outcome, message=message, acknowledged_at=None)


def executed(members: list[Member], broadcast: Answer, remarks: Sequence[Message]) -> Result:
    """The fate of all whose broadcast has left."""
    outcomes = [member.outcome for member in members if member.outcome is not None]
    bad = [outcome for outcome in outcomes if outcome.outcome != "verified"]
    about = bad or [outcome for outcome in outcomes if outcome.message == EXECUTED_SINGLY]
    return Result(
        id="",
        at=0.0,
        outcome="unverified" if bad else "verified",
        message=joined([*(outcome.message for outcome in about), *remarks]),
        units=sorted(outcomes, key=lambda outcome: outcome.unit),
        skew_s=_skew(outcomes, broadcast),
    )


def _skew(outcomes: Iterable[UnitOutcome], broadcast: Answer) -> float | None:
    """Every unit acted after the broadcast's last byte and before it was seen to have acted."""
    proven = [outcome.proven_at for outcome in outcomes if outcome.proven_at is not None]
    return max(proven) - broadcast.sent_at if proven and broadcast.sent_at is not None else None

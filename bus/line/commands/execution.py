"""One unit of a change of many after the broadcast: what it shows, which get a single execute, which moved.
Pure procedures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from bus.contract import UnitOutcome
from bus.line.commands.procedure import (
    CommandContext,
    Procedure,
    ProcedureResult,
    ReportProgress,
    Subprocedure,
    Unstage,
    send,
)
from bus.line.commands.readback import Readback, verify_speed, verify_unchanged
from bus.line.commands.writes import outcome_with_readback
from bus.line.exchange.send import Send, SendResult, SendStatus
from bus.line.roster import Roster, UnitRecord
from bus.messages import Message, joined
from bus.wire.commands import ExecuteSpeedRequest


@dataclass(slots=True)
class Member:
    """One unit of a change."""

    record: UnitRecord
    raw: int
    before: int | None
    """What it was last seen commanded."""
    sent: SendResult | None = None
    outcome: UnitOutcome | None = None

    @property
    def unit(self) -> int:
        return self.record.unit

    @property
    def staged(self) -> bool:
        """Whether it acknowledged the stage of this very change."""
        return (
            self.sent is not None and self.sent.status is SendStatus.RESPONDED and self.sent.refusal is None
        )

    @property
    def may_hold(self) -> bool:
        """Whether its memory may hold the value: it was sent, and not surely refused."""
        return self.sent is not None and self.sent.may_have_acted


EXECUTED_SINGLY = Message("executed_singly")


def verify_all(
    members: list[Member], broadcast: SendResult, roster: Roster, context: CommandContext
) -> Procedure:
    """Read back each member, then those that missed the broadcast, then the units outside the change."""
    for done, member in enumerate(members):
        yield ReportProgress("proving", member.unit, done, len(members))
        yield from verify(member, broadcast, context)
    for member in members:
        if member.outcome is not None and member.outcome.outcome != "verified":
            yield from _execute_singly(member, context)
    strays = yield from _strays(roster, members)
    return executed(members, broadcast, strays)


def verify(member: Member, broadcast: SendResult, context: CommandContext) -> Subprocedure[None]:
    """Whether it shows what it had staged."""
    readback = yield from verify_speed(member.record, member.raw, context.dialect, before=member.before)
    if readback.shown:
        yield Unstage(member.unit)
    outcome = outcome_with_readback(member.unit, broadcast, readback)
    staging, message = member.sent, None
    if not readback.shown:
        # It has the value staged where it missed the broadcast, and the next execute would take it over.
        assert readback.why is not None
        message = Message.of("unit_may_hold", unit=member.unit, reason=readback.why, raw=member.raw)
    member.outcome = msgspec.structs.replace(
        outcome,
        message=message,
        sent_at=staging.sent_at if staging is not None else broadcast.sent_at,
        acknowledged_at=staging.responded_at if staging is not None else None,
        attempts=staging.attempts if staging is not None else 1,
    )


def _execute_singly(member: Member, context: CommandContext) -> Subprocedure[None]:
    """Execute at a unit that does not show its acknowledged stage: it may have missed the broadcast."""
    sent = yield from send(Send(ExecuteSpeedRequest(member.unit)))
    if not sent.may_have_acted:
        return
    yield from verify(member, sent, context)
    if member.outcome is not None and member.outcome.outcome == "verified":
        member.outcome = msgspec.structs.replace(member.outcome, message=EXECUTED_SINGLY)


def _strays(roster: Roster, members: list[Member]) -> Subprocedure[list[Message]]:
    """Return which units outside the change moved with it, staged by another host."""
    inside = {member.unit for member in members}
    moved: list[Message] = []
    for record in roster:
        if record.unit in inside or not roster.is_configured(record.unit):
            continue
        if record.link.link != "online" or record.commanded is None:
            continue
        readback = yield from verify_unchanged(record, record.commanded)
        if readback.why is not None and readback.read_back is not None:
            moved.append(Message.of("outsider_moved", unit=record.unit, reason=readback.why))
    return moved


def unchanged(member: Member, broadcast: SendResult, readback: Readback) -> UnitOutcome:
    """Return the outcome of a unit that had nothing staged from here."""
    message = Message("unit_unchanged")
    if readback.why is not None:
        message = Message.of("unit_remark", unit=member.unit, remark=readback.why)
    outcome = outcome_with_readback(member.unit, broadcast, readback)
    return msgspec.structs.replace(outcome, message=message, acknowledged_at=None)


def executed(members: list[Member], broadcast: SendResult, remarks: Sequence[Message]) -> ProcedureResult:
    """Return the outcome of all whose broadcast has left."""
    outcomes = [member.outcome for member in members if member.outcome is not None]
    bad = [outcome for outcome in outcomes if outcome.outcome != "verified"]
    about = bad or [outcome for outcome in outcomes if outcome.message == EXECUTED_SINGLY]
    # Every unit acted after the broadcast's last byte and before it was seen to have acted.
    proven = [outcome.proven_at for outcome in outcomes if outcome.proven_at is not None]
    return ProcedureResult(
        outcome="unverified" if bad else "verified",
        message=joined([*(outcome.message for outcome in about), *remarks]),
        units=tuple(sorted(outcomes, key=lambda outcome: outcome.unit)),
        skew_s=max(proven) - broadcast.sent_at if proven and broadcast.sent_at is not None else None,
    )

"""No staged speed is left behind: the withdrawal of a change, and the protection of units outside it.

Each unit that may hold a staged speed is given its present one (82h), so that no stray execute changes
anything. Pure procedures.
"""

from __future__ import annotations

from collections.abc import Mapping

from bus.contract import Outcome, UnitOutcome
from bus.line.commands.execution import Member
from bus.line.commands.procedure import CommandContext, ProcedureResult, Subprocedure, Unstage, send
from bus.line.commands.readback import present_setpoint
from bus.line.exchange.send import Send, SendStatus
from bus.line.roster import Roster, UnitRecord
from bus.messages import Message
from bus.wire.commands import StageSpeedRequest


def _stage_present(record: UnitRecord, context: CommandContext) -> Subprocedure[int | None]:
    """Stage the present speed; that speed, or None where the unit did not take it."""
    present = yield from present_setpoint(record, context.dialect)
    if present is None:
        return None
    sent = yield from send(Send(StageSpeedRequest(record.unit, present), withdraws=True))
    if sent.status is not SendStatus.RESPONDED or sent.refusal is not None:
        return None
    yield Unstage(record.unit)
    return present


def withdraw_all(members: list[Member], context: CommandContext) -> Subprocedure[None]:
    """Instead of the broadcast."""
    for member in members:
        if member.may_hold:
            present = yield from _stage_present(member.record, context)
            member.outcome = _withdrawn(member, present)


def _withdrawn(member: Member, present: int | None) -> UnitOutcome:
    assert member.sent is not None
    if present is not None:
        message = Message.of("staged_withdrawn", present=present)
    else:
        message = Message.of("staged_left", raw=member.raw)
    return UnitOutcome(
        unit=member.unit,
        outcome="not_sent" if present is not None else "unverified",
        message=message,
        unit_error=member.sent.refusal,
        sent_at=member.sent.sent_at,
        acknowledged_at=member.sent.responded_at if member.staged else None,
        attempts=member.sent.attempts,
    )


def stopped(members: list[Member], outcome: Outcome, reason: Message) -> ProcedureResult:
    """Return the result of a change that ended before its broadcast, and which units may hold a staged
    value.
    """
    units = [member.outcome or _untouched(member) for member in members]
    left: list[int | str | Message] = [each.unit for each in units if each.outcome == "unverified"]
    refusals = [each.unit_error for each in units if each.unit_error is not None]
    return ProcedureResult(
        outcome=outcome,
        message=Message.of("no_unit_changed_staged_left", reason=reason, units=left)
        if left
        else Message.of("no_unit_changed", reason=reason),
        unit_error=refusals[0] if refusals else None,
        units=tuple(sorted(units, key=lambda each: each.unit)),
    )


def _untouched(member: Member) -> UnitOutcome:
    return UnitOutcome(unit=member.unit, outcome="not_sent", message=Message("unit_untouched"))


class SuspendedStages:
    """Units outside a change that hold a staged speed, kept from executing it with the others."""

    def __init__(self, roster: Roster, setpoints: Mapping[int, int], context: CommandContext) -> None:
        outside = [record for record in roster if record.unit not in setpoints]
        self._waiting = {each.unit: (each, each.staged) for each in outside if each.staged is not None}
        self._sheltered: dict[int, int] = {}
        self._context = context

    def suspend(self) -> Subprocedure[tuple[Outcome, Message] | None]:
        """None when no unit outside the change can move with it."""
        for unit, (record, staged) in self._waiting.items():
            present = yield from _stage_present(record, self._context)
            if present is None:
                return "not_sent", Message.of("outsider_staged", unit=unit, staged=staged)
            self._sheltered[unit] = staged
        return None

    def restore(self) -> Subprocedure[None]:
        """Give each its staged speed back."""
        for unit, staged in self._sheltered.items():
            yield from send(Send(StageSpeedRequest(unit, staged), withdraws=True))

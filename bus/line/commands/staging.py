"""Many units changed as one: stage each, require every ACK, one broadcast, read back each. Pure procedures.

===========  ==========================================================================================
buffer       a unit outside the change that holds a staged speed would execute it too: it is given its
             present speed first, and its staged speed back at the end
stage        82h to each; the first that refuses, times out or comes too late ends the change
broadcast    one 83h to unit 0, only when every 82h *of this very change* was acknowledged
verify       81h to each; one that missed the broadcast gets a single 83h, once, within the deadline
withdraw     instead of the broadcast: every unit that may hold a staged speed of this change is given its
             present one (82h), so that a stray execute changes nothing
===========  ==========================================================================================
"""

from __future__ import annotations

from collections.abc import Mapping

from bus.catalogue.status import status_bits
from bus.contract import Outcome, UnitOutcome
from bus.errors import unit_refused
from bus.line.commands.execution import Member, executed, unchanged, verify, verify_all
from bus.line.commands.procedure import (
    CommandContext,
    Procedure,
    ProcedureResult,
    ReportProgress,
    Subprocedure,
    Unstage,
    send,
)
from bus.line.commands.readback import present_setpoint, verify_unchanged
from bus.line.commands.writes import not_sent, outcome_without_readback
from bus.line.exchange.send import Send, SendStatus
from bus.line.roster import Roster, UnitRecord
from bus.messages import Message
from bus.wire.commands import ExecuteSpeedRequest, StageSpeedRequest

ALL_UNITS = 0


def set_line(roster: Roster, setpoints: Mapping[int, int], context: CommandContext) -> Procedure:
    """Carry out the complete change. ``setpoints``: unit → raw."""
    ordered = _likely_refusals_first(roster, setpoints, context)
    members = [Member(roster[unit], raw, roster[unit].commanded) for unit, raw in ordered]
    if context.exchange_s * len(members) > context.time_left_s:
        return _no_time(members, context)
    suspended = SuspendedStages(roster, setpoints, context)
    failure = yield from suspended.suspend()
    if failure is None:
        failure = yield from _stage_all(members, context)
    if failure is None:
        sent = yield from send(Send(ExecuteSpeedRequest(ALL_UNITS)))
        if sent.status is SendStatus.SENT:
            result = yield from verify_all(members, sent, roster, context)
            yield from suspended.restore()
            return result
        failure = not_sent(ALL_UNITS, sent)
    yield from withdraw_all(members, context)
    yield from suspended.restore()
    return stopped(members, *failure)


def execute_all(roster: Roster, context: CommandContext) -> Procedure:
    """83h to every unit, and what each shows afterwards."""
    records = map(roster.__getitem__, roster.configured)
    members = [Member(record, record.staged or 0, record.commanded) for record in records]
    knew = {member.unit for member in members if member.record.staged is not None}
    sent = yield from send(Send(ExecuteSpeedRequest(ALL_UNITS)))
    if sent.status is not SendStatus.SENT:
        outcome, message = not_sent(ALL_UNITS, sent)
        return ProcedureResult(outcome, message)
    for done, member in enumerate(members):
        yield ReportProgress("proving", member.unit, done, len(members))
        if member.unit in knew:
            yield from verify(member, sent, context)
        else:
            readback = yield from verify_unchanged(member.record, member.before)
            member.outcome = unchanged(member, sent, readback)
    return executed(members, sent, [] if knew else [Message("nothing_staged_here")])


def _likely_refusals_first(
    roster: Roster, setpoints: Mapping[int, int], context: CommandContext
) -> list[tuple[int, int]]:
    """Units that were last seen offline or LOCAL come first: then nothing is staged in the others yet."""

    def well(unit: int) -> bool:
        record = roster[unit]
        if record.link.link in ("stale", "offline") or record.reading is None:
            return False
        reading = record.reading
        return status_bits(reading.outputs, reading.inputs, context.dialect.estop_healthy).remote

    return sorted(setpoints.items(), key=lambda item: well(item[0]))


def _stage_all(
    members: list[Member], context: CommandContext
) -> Subprocedure[tuple[Outcome, Message] | None]:
    """None when every unit acknowledged, else how the change ended and why."""
    for done, member in enumerate(members):
        yield ReportProgress("sent", member.unit, done, len(members))
        member.sent = yield from send(Send(StageSpeedRequest(member.unit, member.raw)))
        if not member.staged:
            return _why_stopped(member)
        if context.cancelled:
            return "not_sent", Message("canceled_before_execute")
    yield ReportProgress("acknowledged", None, len(members), len(members))
    return None


def _why_stopped(member: Member) -> tuple[Outcome, Message]:
    assert member.sent is not None
    sent = member.sent
    if sent.refusal is not None:
        member.outcome = outcome_without_readback(member.unit, sent)
        return "refused", unit_refused(member.unit, sent.refusal)
    if sent.status is SendStatus.TIMED_OUT:
        return "unverified", Message.of("unit_no_response", unit=member.unit)
    if sent.status is SendStatus.PORT_CLOSED:
        return "bus_closed", Message("bus_link_lost")
    return "not_sent", Message("deadline_passed_staging")


def _no_time(members: list[Member], context: CommandContext) -> ProcedureResult:
    seconds = context.exchange_s * len(members)
    allowed = round(max(context.time_left_s, 0), 1)
    message = Message.of("change_too_long", n=len(members), seconds=round(seconds, 1), allowed=allowed)
    return ProcedureResult("not_sent", message)


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
    """Return the result of a change that ended before its broadcast, and the units that may be staged."""
    untouched = Message("unit_untouched")
    units = [each.outcome or UnitOutcome(each.unit, "not_sent", untouched) for each in members]
    left = [each.unit for each in units if each.outcome == "unverified"]
    refusals = [each.unit_error for each in units if each.unit_error is not None]
    return ProcedureResult(
        outcome=outcome,
        message=Message.of("no_unit_changed_staged_left", reason=reason, units=left)
        if left
        else Message.of("no_unit_changed", reason=reason),
        unit_error=refusals[0] if refusals else None,
        units=tuple(sorted(units, key=lambda each: each.unit)),
    )


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

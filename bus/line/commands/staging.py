"""Pure procedures that change many units as one: stage each, require every ACK, one broadcast, read back
each.

===========  ==========================================================================================
suspend      a unit outside the change that holds a staged speed would execute it too: it is given its
             present speed first, and its staged speed back at the end
stage        82h to each, after its scale if its value was typed; the first that refuses, times out, comes
             too late or has another scale ends the change
broadcast    one 83h to unit 0, only when every 82h *of this very change* was acknowledged
verify       81h to each, and its scale again; one that missed the broadcast gets a single 83h, once, within
             the deadline
withdraw     instead of the broadcast: every unit that may hold a staged speed of this change is given its
             present one (82h), so that a stray execute changes nothing
===========  ==========================================================================================
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from msgspec.structs import replace

from bus.catalogue.parameters import FOLLOWER_MODE
from bus.catalogue.values import is_follower, status_bits
from bus.contract import Outcome, UnitOutcome, UnitScale
from bus.errors import unit_refused
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
from bus.line.commands.writes import (
    SUCCEEDED,
    ScaleReading,
    not_sent,
    outcome_before_write,
    outcome_in_scale,
    outcome_of,
    outcome_with_readback,
    outcome_without_readback,
    present_setpoint,
    verify_speed,
    verify_unchanged,
)
from bus.line.roster import Roster, UnitRecord
from bus.line.send import Send, SendResult, SendStatus
from bus.messages import Message, joined
from bus.wire.commands import ExecuteSpeedRequest, StageSpeedRequest

ALL_UNITS = 0
EXECUTED_SINGLY = Message("executed_singly")

Failure = tuple[Outcome, Message]
CANCELED: Failure = ("not_sent", Message("canceled_before_execute"))
Suspended = dict[int, tuple[int, UnitScale]]
"""The staged speed of each unit, by address, and the scale with which it was converted."""


@dataclass(slots=True)
class Member:
    """A unit of a change. ``before``: its commanded speed as last read. ``scale``: the parameters with
    which its value was converted, ``guarded`` if a person typed that value."""

    record: UnitRecord
    raw: int
    before: int | None
    scale: UnitScale
    guarded: bool
    sent: SendResult | None = None
    """The result of the request that staged the speed."""
    outcome: UnitOutcome | None = None
    missed_broadcast: bool = False
    """Whether the unit does not show the speed that it had staged."""

    @property
    def unit(self) -> int:
        return self.record.unit


def set_line(roster: Roster, setpoints: Mapping[int, int], context: CommandContext) -> Procedure:
    """Change all units of ``setpoints`` (unit → raw) together, or none."""
    ordered = _likely_refusals_first(roster, setpoints, context)
    members = [
        Member(roster[unit], raw, roster[unit].commanded, context.scale(unit), context.typed)
        for unit, raw in ordered
    ]
    seconds = context.exchange_s * len(members)
    if seconds > context.time_left_s:
        allowed = round(max(context.time_left_s, 0), 1)
        message = Message.of("change_too_long", n=len(members), seconds=round(seconds, 1), allowed=allowed)
        return ProcedureResult("not_sent", message)
    suspended, failure = yield from _suspend_others(roster, setpoints, context)
    if failure is None:
        failure = yield from _stage_all(members, context)
    if failure is None:
        sent = yield from send(Send(ExecuteSpeedRequest(ALL_UNITS)))
        if sent.status is SendStatus.SENT:
            result = yield from _verify_all(members, sent, roster, context)
            yield from _restage(suspended)
            return result
        failure = not_sent(ALL_UNITS, sent)
    yield from _withdraw_all(members, context)
    yield from _restage(suspended)
    return _stopped(members, *failure)


def execute_all(roster: Roster, context: CommandContext) -> Procedure:
    """Send 83h to every unit, and read each one afterwards."""
    records = list(map(roster.__getitem__, roster.configured))
    unknown = [record.unit for record in records if record.staged_unknown]
    if unknown:
        return ProcedureResult("refused", Message.of("staged_unknown", unit=unknown))
    members = [
        Member(
            record,
            record.staged or 0,
            record.commanded,
            {**context.scale(record.unit), **record.staged_scale},
            context.typed or bool(record.staged_scale),
        )
        for record in records
    ]
    knew = {member.unit for member in members if member.record.staged is not None}
    failure = yield from _read_scales([member for member in members if member.unit in knew], context)
    if failure is not None:
        return _stopped(members, *failure)
    yield from _suspend_others(roster, roster.configured, context)
    sent = yield from send(Send(ExecuteSpeedRequest(ALL_UNITS)))
    if sent.status is not SendStatus.SENT:
        return ProcedureResult(*not_sent(ALL_UNITS, sent))
    for done, member in enumerate(members):
        yield ReportProgress("proving", member.unit, done, len(members))
        if member.unit in knew:
            yield from _verify(member, sent, context)
        else:
            yield from _verify_unchanged(member, sent)
    context.only_reads = True
    yield from _verify_scales([member for member in members if member.unit in knew])
    return _executed(members, sent, [] if knew else [Message("nothing_staged_here")])


# --- before the broadcast ------------------------------------------------------------------------


def _likely_refusals_first(
    roster: Roster, setpoints: Mapping[int, int], context: CommandContext
) -> list[tuple[int, int]]:
    """Sort units that were last seen offline or LOCAL first, because nothing is staged in the others yet if
    they refuse."""

    def well(unit: int) -> bool:
        record = roster[unit]
        if record.link.link in ("stale", "offline") or record.reading is None:
            return False
        reading = record.reading
        return status_bits(reading.outputs, reading.inputs, context.dialect.estop_healthy).remote

    return sorted(setpoints.items(), key=lambda item: well(item[0]))


def _suspend_others(
    roster: Roster, setpoints: Collection[int], context: CommandContext
) -> Subprocedure[tuple[Suspended, Failure | None]]:
    """Suspend the staged speeds of units outside the change. Return those to give back at the end, and why
    the change must not go on; None if it may."""
    outside = [record for record in roster if record.unit not in setpoints]
    suspended: Suspended = {}
    for record in outside:
        staged, scale = record.staged, record.staged_scale
        if staged is None and not record.staged_unknown:
            continue
        if (yield from _stage_present(record, context)) is None:
            if not roster.is_configured(record.unit):
                continue  # It was taken away, most likely: that must not keep every change from being sent.
            reason = Message.of("outsider_unknown", unit=record.unit)
            if staged is not None:
                reason = Message.of("outsider_staged", unit=record.unit, staged=staged)
            return suspended, ("not_sent", reason)
        if staged is not None:
            suspended[record.unit] = staged, scale
    return suspended, None


def _stage_all(members: list[Member], context: CommandContext) -> Subprocedure[Failure | None]:
    """Stage each unit; return None if every one acknowledged, else how the change ended and why."""
    if (failure := (yield from _read_scales(members, context))) is not None:
        return failure
    for done, member in enumerate(members):
        yield ReportProgress("sent", member.unit, done, len(members))
        member.sent = yield from send(Send(StageSpeedRequest(member.unit, member.raw)))
        if not member.sent.acknowledged:
            return _why_stopped(member, member.sent)
        if member.guarded:
            yield NoteStagedScale(member.unit, member.scale)
        if context.cancelled:
            return CANCELED
    yield ReportProgress("acknowledged", None, len(members), len(members))
    return None


def _read_scales(members: list[Member], context: CommandContext) -> Subprocedure[Failure | None]:
    """Read the scale of each typed value again; return how the change ends if a unit has another one by now.

    The units are read in turn, one parameter each: between two reads of one unit the link polls it, as their
    responses look alike (``bus.wire.exchange``), and 24 units would take longer than the 2 s of a command.
    """
    readings = {member.unit: ScaleReading(member.unit, member.scale) for member in members if member.guarded}
    while any(reading.remaining for reading in readings.values()):
        for member in members:
            if (reading := readings.get(member.unit)) is None:
                continue
            yield from reading.read_next()
            if reading.difference is not None:
                yield from reading.read_all()
                member.outcome = outcome_before_write(member.unit, reading.difference)
                return member.outcome.outcome, reading.difference[1]
            if context.cancelled:
                return CANCELED
    return None


def _why_stopped(member: Member, sent: SendResult) -> Failure:
    if sent.refusal is not None:
        member.outcome = outcome_without_readback(member.unit, sent)
        return "refused", unit_refused(member.unit, sent.refusal)
    if sent.status is SendStatus.TIMED_OUT:
        return "unverified", Message.of("unit_no_response", unit=member.unit)
    if sent.status is SendStatus.PORT_CLOSED:
        return "bus_closed", Message("bus_link_lost")
    return "not_sent", Message("deadline_passed_staging")


def _stage_present(record: UnitRecord, context: CommandContext) -> Subprocedure[int | None]:
    """Stage the present speed and return it, or None if the unit did not take it."""
    present = yield from present_setpoint(record, context.dialect)
    if present is None:
        return None
    sent = yield from send(Send(StageSpeedRequest(record.unit, present), withdraws=True))
    if not sent.acknowledged:
        return None
    yield Unstage(record.unit)
    return present


def _withdraw_all(members: list[Member], context: CommandContext) -> Subprocedure[None]:
    """Withdraw the staged speed of each member that may hold it, instead of the broadcast."""
    for member in members:
        if member.sent is None or not member.sent.may_have_acted:
            continue
        present = yield from _stage_present(member.record, context)
        if present is not None:
            outcome: Failure = "not_sent", Message.of("staged_withdrawn", present=present)
        else:
            outcome = "unverified", Message.of("staged_left", raw=member.raw)
        member.outcome = outcome_of(member.unit, member.sent, *outcome)


def _restage(suspended: Suspended) -> Subprocedure[None]:
    """Stage again what each unit outside the change held before."""
    for unit, (staged, scale) in suspended.items():
        sent = yield from send(Send(StageSpeedRequest(unit, staged), withdraws=True))
        if sent.acknowledged:
            yield NoteStagedScale(unit, scale)


def _stopped(members: list[Member], outcome: Outcome, reason: Message) -> ProcedureResult:
    """Return the result of a change that ended before its broadcast, with the units that may be staged."""
    untouched = Message("unit_untouched")
    units = [each.outcome or UnitOutcome(each.unit, "not_sent", untouched) for each in members]
    # Where the scale could not be read again, nothing was sent.
    left = [
        each.unit
        for each, member in zip(units, members, strict=True)
        if each.outcome == "unverified" and member.sent is not None
    ]
    return ProcedureResult(
        outcome=outcome,
        message=Message.of("no_unit_changed_staged_left", reason=reason, units=left)
        if left
        else Message.of("no_unit_changed", reason=reason),
        unit_error=next((each.unit_error for each in units if each.unit_error is not None), None),
        units=sorted(units, key=lambda each: each.unit),
    )


# --- after the broadcast -------------------------------------------------------------------------


def _verify_all(
    members: list[Member], broadcast: SendResult, roster: Roster, context: CommandContext
) -> Procedure:
    """Read back each member, execute singly where one missed the broadcast, and check the other units."""
    for done, member in enumerate(members):
        yield ReportProgress("proving", member.unit, done, len(members))
        yield from _verify(member, broadcast, context)
    context.only_reads = not any(member.missed_broadcast for member in members)
    yield from _verify_scales(members)
    for member in members:
        if member.missed_broadcast:
            yield from _execute_singly(member, context)
    strays = yield from _strays(roster, members, context)
    return _executed(members, broadcast, strays)


def _verify(member: Member, broadcast: SendResult, context: CommandContext) -> Subprocedure[None]:
    """Read a member back and set its outcome by whether it shows the speed that it had staged."""
    readback = yield from verify_speed(member.record, member.raw, context.dialect, before=member.before)
    staging, message = member.sent, None
    if readback.shown:
        yield Unstage(member.unit)
    else:
        # A unit that missed the broadcast holds the value still, and the next execute would take it over.
        assert readback.why is not None
        message = Message.of("unit_may_hold", unit=member.unit, reason=readback.why, raw=member.raw)
    member.missed_broadcast = not readback.shown
    member.outcome = replace(
        outcome_with_readback(member.unit, broadcast, readback),
        message=message,
        sent_at=staging.sent_at if staging is not None else broadcast.sent_at,
        acknowledged_at=staging.responded_at if staging is not None else None,
        attempts=staging.attempts if staging is not None else 1,
    )


def _verify_scales(members: Sequence[Member]) -> Subprocedure[None]:
    """Read the scale of each verified unit again, one parameter of each unit in turn."""
    succeeded = [each for each in members if each.outcome is not None and each.outcome.outcome in SUCCEEDED]
    readings = {member.unit: ScaleReading(member.unit, member.scale) for member in succeeded}
    while any(reading.remaining for reading in readings.values()):
        for reading in readings.values():
            # The app waits for a command for as long as it makes progress.
            yield ReportProgress("proving", reading.unit, len(members), len(members))
            yield from reading.read_next()
    for member in succeeded:
        assert member.outcome is not None
        member.outcome = outcome_in_scale(member.outcome, readings[member.unit], guarded=member.guarded)


def _verify_unchanged(member: Member, broadcast: SendResult) -> Subprocedure[None]:
    """Read a unit for which nothing was staged from here, and set its outcome by whether it is as before."""
    readback = yield from verify_unchanged(member.record, member.before)
    message = Message("unit_unchanged")
    if readback.why is not None:
        message = Message.of("unit_remark", unit=member.unit, remark=readback.why)
    outcome = outcome_with_readback(member.unit, broadcast, readback)
    member.outcome = replace(outcome, message=message, acknowledged_at=None)


def _execute_singly(member: Member, context: CommandContext) -> Subprocedure[None]:
    """Execute at a unit that does not show its acknowledged staged speed. It may have missed the broadcast,
    because it was being switched off or set up at its keypad."""
    now = ScaleReading(member.unit, member.scale if member.guarded else {})
    yield from now.read_all()
    if now.difference is not None:
        return
    sent = yield from send(Send(ExecuteSpeedRequest(member.unit)))
    if not sent.may_have_acted:
        return
    yield from _verify(member, sent, context)
    yield from _verify_scales([member])
    if member.outcome is not None and member.outcome.outcome == "verified":
        member.outcome = replace(member.outcome, message=EXECUTED_SINGLY)


def _strays(roster: Roster, members: list[Member], context: CommandContext) -> Subprocedure[list[Message]]:
    """Return remarks about the units outside the change that moved with it, staged by another host. A
    follower whose commanded speed is a speed moves with its master."""
    inside = {member.unit for member in members}
    moved: list[Message] = []
    for record in map(roster.__getitem__, roster.configured):
        if record.unit in inside or record.link.link != "online" or record.commanded is None:
            continue
        if context.dialect.follower_speed == "speed" and is_follower(record.raw(FOLLOWER_MODE)):
            continue
        readback = yield from verify_unchanged(record, record.commanded)
        if readback.why is not None and readback.read_back is not None:
            moved.append(Message.of("outsider_moved", unit=record.unit, reason=readback.why))
    return moved


def _executed(members: list[Member], broadcast: SendResult, remarks: Sequence[Message]) -> ProcedureResult:
    """Return the result of a change whose broadcast has left."""
    outcomes = [member.outcome for member in members if member.outcome is not None]
    bad = [outcome for outcome in outcomes if outcome.outcome != "verified"]
    about = bad or [outcome for outcome in outcomes if outcome.message == EXECUTED_SINGLY]
    # Every unit acted after the broadcast's last byte and before it was seen to have acted.
    proven = [outcome.proven_at for outcome in outcomes if outcome.proven_at is not None]
    return ProcedureResult(
        outcome="unverified" if bad else "verified",
        message=joined([*(outcome.message for outcome in about), *remarks]),
        units=sorted(outcomes, key=lambda outcome: outcome.unit),
        skew_s=max(proven) - broadcast.sent_at if proven and broadcast.sent_at is not None else None,
    )

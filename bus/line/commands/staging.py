"""Many units changed as one: stage each, require every ACK, one broadcast, prove each. Pure procedures.

===========  ==========================================================================================
shelter      a unit outside the change that holds a staged speed would execute it too: it is given its
             present speed first, and its staged speed back at the end
stage        82h to each; the first that refuses, is silent or comes too late ends the change
broadcast    one 83h to unit 0, only when every 82h *of this very change* was acknowledged
prove        81h to each; one that missed the broadcast is told singly (83h), once, within the deadline
withdraw     instead of the broadcast: every unit that may hold a staged speed of this change is given its
             present one (82h), so that no stray execute can surprise anybody
===========  ==========================================================================================
"""

from __future__ import annotations

from collections.abc import Generator, Mapping

from bus.catalogue.status import status_bits
from bus.contract import Outcome, Result
from bus.errors import unit_refused
from bus.line.commands.execution import executed, prove, prove_all, unchanged
from bus.line.commands.member import Member, member_of
from bus.line.commands.procedure import Answer, Ask, Fate, Procedure, Step, Tell, Wish
from bus.line.commands.readback import ask, prove_unchanged
from bus.line.commands.withdrawal import Shelter, stopped, withdraw_all
from bus.line.commands.writes import not_sent, without_proof
from bus.line.roster import Roster
from bus.messages import Message
from bus.wire.commands import ExecuteSpeed, StageSpeed

ALL_UNITS = 0


def set_line(roster: Roster, setpoints: Mapping[int, int], wish: Wish) -> Procedure:
    """The whole change. ``setpoints``: unit → raw."""
    members = [member_of(roster[unit], raw) for unit, raw in _likely_refusals_first(roster, setpoints, wish)]
    if wish.exchange_s * len(members) > wish.time_left_s:
        return _no_time(members, wish)
    shelter = Shelter(roster, setpoints, wish)
    trouble = yield from shelter.enter()
    if trouble is None:
        trouble = yield from _stage_all(members, wish)
    if trouble is None:
        answer = yield from ask(Ask(ExecuteSpeed(ALL_UNITS)))
        if answer.fate is Fate.SENT:
            result = yield from prove_all(members, answer, roster, wish)
            yield from shelter.leave()
            return result
        trouble = not_sent(ALL_UNITS, answer)
    yield from withdraw_all(members, wish)
    yield from shelter.leave()
    return stopped(members, *trouble)


def execute_all(roster: Roster, wish: Wish) -> Procedure:
    """83h to every unit, and what each shows afterwards."""
    members = [member_of(roster[unit], roster[unit].staged or 0) for unit in roster.configured]
    knew = {member.unit for member in members if member.record.staged is not None}
    answer = yield from ask(Ask(ExecuteSpeed(ALL_UNITS)))
    if answer.fate is not Fate.SENT:
        outcome, message = not_sent(ALL_UNITS, answer)
        return Result(id="", at=0.0, outcome=outcome, message=message)
    for done, member in enumerate(members):
        yield Tell("proving", member.unit, done, len(members))
        if member.unit in knew:
            yield from prove(member, answer, wish)
        else:
            proof = yield from prove_unchanged(member.record, member.before)
            member.outcome = unchanged(member, answer, proof)
    return executed(members, answer, [] if knew else [Message("nothing_staged_here")])


def _likely_refusals_first(roster: Roster, setpoints: Mapping[int, int], wish: Wish) -> list[tuple[int, int]]:
    """Units that were last seen silent or LOCAL come first: then nothing is staged in the others yet."""

    def well(unit: int) -> bool:
        record = roster[unit]
        if record.link.link in ("stale", "offline") or record.reading is None:
            return False
        reading = record.reading
        return status_bits(reading.outputs, reading.inputs, wish.dialect.estop_healthy).remote

    return sorted(setpoints.items(), key=lambda item: well(item[0]))


def _stage_all(
    members: list[Member], wish: Wish
) -> Generator[Step, Answer | None, tuple[Outcome, Message] | None]:
    """None when every unit acknowledged, else how the change ended and why."""
    for done, member in enumerate(members):
        yield Tell("sent", member.unit, done, len(members))
        member.answer = yield from ask(Ask(StageSpeed(member.unit, member.raw)))
        if not member.staged:
            return _why_stopped(member)
        if wish.cancelled:
            return "not_sent", Message("canceled_before_execute")
    yield Tell("acknowledged", None, len(members), len(members))
    return None


def _why_stopped(member: Member) -> tuple[Outcome, Message]:
    assert member.answer is not None
    answer = member.answer
    if answer.refusal is not None:
        member.outcome = without_proof(member.unit, answer)
        return "refused", unit_refused(member.unit, answer.refusal)
    if answer.fate is Fate.SILENT:
        return "unverified", Message.of("unit_no_response", unit=member.unit)
    if answer.fate is Fate.CLOSED:
        return "bus_closed", Message("bus_link_lost")
    return "not_sent", Message("deadline_passed_staging")


def _no_time(members: list[Member], wish: Wish) -> Result:
    seconds = wish.exchange_s * len(members)
    message = Message.of(
        "change_too_long",
        n=len(members),
        seconds=round(seconds, 1),
        allowed=round(max(wish.time_left_s, 0), 1),
    )
    return Result(id="", at=0.0, outcome="not_sent", message=message)

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

from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass

import msgspec

from bus.catalogue.status import status_bits
from bus.contract import Outcome, Result, UnitOutcome
from bus.errors import unit_error_name
from bus.line.proof import Proof, ask, present_setpoint, prove_speed, prove_unchanged
from bus.line.roster import Roster, UnitRecord
from bus.line.steps import Answer, Ask, Fate, Procedure, Step, Tell, Unstage, Wish
from bus.line.writes import not_sent, with_proof, without_proof
from bus.wire.commands import ExecuteSpeed, StageSpeed

ALL_UNITS = 0

Part = Generator[Step, Answer | None, None]


@dataclass(slots=True)
class _Member:
    """One unit of a change."""

    record: UnitRecord
    raw: int
    before: int | None = None
    answer: Answer | None = None
    outcome: UnitOutcome | None = None

    @property
    def unit(self) -> int:
        return self.record.unit

    @property
    def staged(self) -> bool:
        return self.answer is not None and self.answer.fate is Fate.ANSWERED and self.answer.refusal is None

    @property
    def may_hold(self) -> bool:
        """Whether its memory may hold the value: it was sent, and not surely refused."""
        return self.answer is not None and self.answer.may_have_acted


def set_line(roster: Roster, setpoints: Mapping[int, int], wish: Wish) -> Procedure:
    """The whole change. ``setpoints``: unit → raw."""
    members = [_member(roster[unit], raw) for unit, raw in _likely_refusals_first(roster, setpoints, wish)]
    if wish.exchange_s * len(members) > wish.time_left_s:
        return _no_time(members, wish)
    shelter = _Shelter([record for record in roster if _would_also_move(record, setpoints)], wish)
    trouble = yield from shelter.enter()
    if trouble is None:
        trouble = yield from _stage_all(members, wish)
    if trouble is None:
        answer = yield from ask(Ask(ExecuteSpeed(ALL_UNITS)))
        if answer.fate is Fate.SENT:
            result = yield from _prove_all(members, answer, roster, wish)
            yield from shelter.leave()
            return result
        trouble = not_sent(ALL_UNITS, answer)
    yield from _withdraw_all(members, wish)
    yield from shelter.leave()
    return _stopped(members, *trouble)


def execute_all(roster: Roster, wish: Wish) -> Procedure:
    """83h to every unit, and what each shows afterwards."""
    members = [_member(roster[unit], roster[unit].staged or 0) for unit in roster.configured]
    knew = {member.unit for member in members if member.record.staged is not None}
    answer = yield from ask(Ask(ExecuteSpeed(ALL_UNITS)))
    if answer.fate is not Fate.SENT:
        outcome, message = not_sent(ALL_UNITS, answer)
        return Result(id="", at=0.0, outcome=outcome, message=message)
    for done, member in enumerate(members):
        yield Tell("proving", member.unit, done, len(members))
        if member.unit in knew:
            yield from _prove(member, answer, wish)
        else:
            proof = yield from prove_unchanged(member.record, member.before)
            member.outcome = _unchanged(member, answer, proof)
    return _executed(members, answer, "no unit held a speed staged from here" if not knew else "")


# --- stage ---------------------------------------------------------------------------------------


def _member(record: UnitRecord, raw: int) -> _Member:
    return _Member(record, raw, record.reading.commanded if record.reading is not None else None)


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
    members: list[_Member], wish: Wish
) -> Generator[Step, Answer | None, tuple[Outcome, str] | None]:
    """None when every unit acknowledged, else how the change ended and why."""
    for done, member in enumerate(members):
        yield Tell("sent", member.unit, done, len(members))
        member.answer = yield from ask(Ask(StageSpeed(member.unit, member.raw)))
        if not member.staged:
            return _why_stopped(member)
        if wish.cancelled:
            return "not_sent", "given up before it was executed"
    yield Tell("acknowledged", None, len(members), len(members))
    return None


def _why_stopped(member: _Member) -> tuple[Outcome, str]:
    assert member.answer is not None
    answer = member.answer
    if answer.refusal is not None:
        member.outcome = without_proof(member.unit, answer)
        return "refused", f"unit {member.unit} refused: {unit_error_name(answer.refusal)}"
    if answer.fate is Fate.SILENT:
        return "unverified", f"unit {member.unit} did not answer"
    if answer.fate is Fate.CLOSED:
        return "bus_closed", "the link to the bus was lost"
    return "not_sent", "its time was over before every unit had acknowledged"


def _no_time(members: list[_Member], wish: Wish) -> Result:
    seconds = wish.exchange_s * len(members)
    message = (
        f"staging {len(members)} units takes {seconds:.1f} s on this bus and "
        f"{max(wish.time_left_s, 0):.1f} s were given: nothing was sent"
    )
    return Result(id="", at=0.0, outcome="not_sent", message=message)


# --- prove ---------------------------------------------------------------------------------------


def _prove_all(members: list[_Member], broadcast: Answer, roster: Roster, wish: Wish) -> Procedure:
    for done, member in enumerate(members):
        yield Tell("proving", member.unit, done, len(members))
        yield from _prove(member, broadcast, wish)
    for member in members:
        if member.outcome is not None and member.outcome.outcome != "verified":
            yield from _tell_singly(member, wish)
    strays = yield from _strays(roster, members)
    return _executed(members, broadcast, strays)


def _prove(member: _Member, broadcast: Answer, wish: Wish) -> Part:
    proof = yield from prove_speed(member.record, member.raw, wish.dialect, before=member.before)
    if proof.shown:
        yield Unstage(member.unit)
    outcome = with_proof(member.unit, broadcast, proof)
    staging = member.answer
    member.outcome = msgspec.structs.replace(
        outcome,
        message="" if proof.shown else _not_shown(member, proof),
        sent_at=staging.sent_at if staging is not None else broadcast.sent_at,
        acknowledged_at=staging.answered_at if staging is not None else None,
        attempts=staging.attempts if staging is not None else 1,
    )


def _not_shown(member: _Member, proof: Proof) -> str:
    """Whoever missed the broadcast has the value in its memory, and the next execute would find it there."""
    return f"unit {member.unit}: {proof.why}; it may still hold {member.raw} staged"


def _tell_singly(member: _Member, wish: Wish) -> Part:
    """It acknowledged its stage and does not show it: it may have missed the one frame nobody answers."""
    answer = yield from ask(Ask(ExecuteSpeed(member.unit)))
    if not answer.may_have_acted:
        return
    yield from _prove(member, answer, wish)
    if member.outcome is not None and member.outcome.outcome == "verified":
        message = "missed the broadcast and was told singly"
        member.outcome = msgspec.structs.replace(member.outcome, message=message)


def _strays(roster: Roster, members: list[_Member]) -> Generator[Step, Answer | None, str]:
    """In words, which units outside the change moved with it, staged by somebody else."""
    inside = {member.unit for member in members}
    moved: list[str] = []
    for record in roster:
        if record.unit in inside or not roster.is_configured(record.unit):
            continue
        if record.link.link != "online" or record.reading is None:
            continue
        proof = yield from prove_unchanged(record, record.reading.commanded)
        if not proof.shown and proof.read_back is not None:
            moved.append(f"unit {record.unit}, which was not part of the change: {proof.why}")
    return "; ".join(moved)


def _unchanged(member: _Member, broadcast: Answer, proof: Proof) -> UnitOutcome:
    if proof.shown:
        message = "nothing was staged from here, and its commanded speed is unchanged"
    else:
        message = f"unit {member.unit}: {proof.why}"
    outcome = with_proof(member.unit, broadcast, proof)
    return msgspec.structs.replace(outcome, message=message, acknowledged_at=None)


def _executed(members: list[_Member], broadcast: Answer, remark: str) -> Result:
    outcomes = [member.outcome for member in members if member.outcome is not None]
    bad = [outcome for outcome in outcomes if outcome.outcome != "verified"]
    words = [outcome.message for outcome in bad] or [o.message for o in outcomes if "singly" in o.message]
    return Result(
        id="",
        at=0.0,
        outcome="unverified" if bad else "verified",
        message="; ".join([*words, *([remark] if remark else [])]),
        units=sorted(outcomes, key=lambda outcome: outcome.unit),
        skew_s=_skew(outcomes, broadcast),
    )


def _skew(outcomes: Iterable[UnitOutcome], broadcast: Answer) -> float | None:
    """Every unit acted after the broadcast's last byte and before it was seen to have acted."""
    proven = [outcome.proven_at for outcome in outcomes if outcome.proven_at is not None]
    return max(proven) - broadcast.sent_at if proven and broadcast.sent_at is not None else None


# --- withdraw and shelter ------------------------------------------------------------------------


def _would_also_move(record: UnitRecord, setpoints: Mapping[int, int]) -> bool:
    return record.staged is not None and record.unit not in setpoints


def _put_back(record: UnitRecord, wish: Wish) -> Generator[Step, Answer | None, int | None]:
    """Stage the present speed; that speed, or None where the unit did not take it."""
    present = yield from present_setpoint(record, wish.dialect)
    if present is None:
        return None
    answer = yield from ask(Ask(StageSpeed(record.unit, present), withdraws=True))
    if answer.fate is not Fate.ANSWERED or answer.refusal is not None:
        return None
    yield Unstage(record.unit)
    return present


def _withdraw_all(members: list[_Member], wish: Wish) -> Part:
    for member in members:
        if member.may_hold:
            present = yield from _put_back(member.record, wish)
            member.outcome = _withdrawn(member, present)


def _withdrawn(member: _Member, present: int | None) -> UnitOutcome:
    assert member.answer is not None
    if present is not None:
        message = f"staged and put back to its present speed ({present}); not executed"
    else:
        message = (
            f"may still hold {member.raw} staged, for it could not be put back: stage its present speed "
            "before anything is executed on this line"
        )
    return UnitOutcome(
        unit=member.unit,
        outcome="not_sent" if present is not None else "unverified",
        message=message,
        unit_error=member.answer.refusal,
        sent_at=member.answer.sent_at,
        acknowledged_at=member.answer.answered_at if member.staged else None,
        attempts=member.answer.attempts,
    )


def _stopped(members: list[_Member], outcome: Outcome, why: str) -> Result:
    units = [member.outcome or _untouched(member) for member in members]
    left = [str(each.unit) for each in units if each.outcome == "unverified"]
    warning = f"; may still be staged in unit {', '.join(left)}" if left else ""
    refusals = [each.unit_error for each in units if each.unit_error is not None]
    return Result(
        id="",
        at=0.0,
        outcome=outcome,
        message=f"{why}: no unit was changed{warning}",
        unit_error=refusals[0] if refusals else None,
        units=sorted(units, key=lambda each: each.unit),
    )


def _untouched(member: _Member) -> UnitOutcome:
    return UnitOutcome(unit=member.unit, outcome="not_sent", message="nothing was sent to it")


class _Shelter:
    """Units outside a change that hold a staged speed, kept from executing it with the others."""

    def __init__(self, records: list[UnitRecord], wish: Wish) -> None:
        self._waiting = {record.unit: (record, record.staged) for record in records}
        self._sheltered: dict[int, int] = {}
        self._wish = wish

    def enter(self) -> Generator[Step, Answer | None, tuple[Outcome, str] | None]:
        """None when no unit outside the change can move with it."""
        for unit, (record, staged) in self._waiting.items():
            present = yield from _put_back(record, self._wish)
            if present is None:
                return "not_sent", (
                    f"unit {unit} is not part of the change but holds {staged} staged, would execute it too, "
                    "and could not be put back to its present speed"
                )
            self._sheltered[unit] = staged if staged is not None else present
        return None

    def leave(self) -> Part:
        """Give each its staged speed back."""
        for unit, staged in self._sheltered.items():
            yield from ask(Ask(StageSpeed(unit, staged), withdraws=True))

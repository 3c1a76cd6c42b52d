"""Pure procedures for a complete bus: a change of its baud rate, and a scan between polls.

Whether a unit changes its rate (#18) at once or at its next power-up is not known (protocol, 4), so after the
writes each unit is polled at both rates. If all respond at the new one, the host stays there. If all respond
at the old one, every #18 is read back, and the host follows when the units have been switched off and on. In
any other case every unit is written its old rate at whichever rate it responds; if even that fails, the
result names the panels and what to set there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from bus.catalogue.parameters import BAUD_RATE
from bus.contract import FoundUnit, Outcome, UnitOutcome
from bus.contract.actions import POLL_BYTES
from bus.errors import unit_refused
from bus.line.commands.procedure import (
    CommandContext,
    ExpectBaud,
    Procedure,
    ProcedureResult,
    ReportProgress,
    Retune,
    Subprocedure,
    Wait,
    send,
)
from bus.line.commands.writes import read_parameter
from bus.line.examination import Examination, Found, Passes, Probe, ProbeOutcome, conclude, no_response_s
from bus.line.roster import Roster
from bus.line.send import Send, SendResult, SendStatus
from bus.messages import Message, joined
from bus.settings import BAUDS, wire_seconds
from bus.wire.commands import ReadStatusRequest, WriteParameterRequest

HUNDREDS = 100
READ_ATTEMPTS = 2


def change_baud(
    roster: Roster, old: int, new: int, context: CommandContext, *, own_rate: bool = True
) -> Procedure:
    """Change from ``old``, the present rate, to ``new``. ``own_rate``: whether the port's rate can be set."""
    if not own_rate:
        return ProcedureResult("invalid", Message("baud_of_device_server"))
    if new not in BAUDS or new == old:
        rates = [rate for rate in BAUDS if rate != old]
        return ProcedureResult("invalid", Message.of("baud_not_possible", baud=old, rates=rates))
    return (yield from _Change(roster, old, new, context).run())


class _Change:
    def __init__(self, roster: Roster, old: int, new: int, context: CommandContext) -> None:
        self._roster = roster
        self._units = roster.configured
        self._old = old
        self._new = new
        self._context = context

    def run(self) -> Procedure:
        failure = yield from self._write_all()
        if failure is not None:
            return (yield from self._go_back(*failure))
        yield ReportProgress("proving", None, 0, len(self._units))
        everyone = set(self._units)
        at_old = yield from self._responding(self._units)
        if at_old != everyone:
            yield Retune(self._new)
            at_new = yield from self._responding([unit for unit in self._units if unit not in at_old])
            if at_new != everyone:
                return (yield from self._go_back("unverified", self._disagree(at_old, at_new)))
        missing = yield from self._not_holding(self._units, self._new)
        if missing and at_old == everyone:
            return (yield from self._go_back("unverified", Message.of("baud_not_held", units=missing)))
        if missing:
            message = Message.of("baud_readback_differs", units=missing, baud=self._new)
            return ProcedureResult("unverified", message, self._outcomes(missing))
        yield ExpectBaud(self._new)
        if at_old == everyone:
            message = Message.of("baud_at_power_up", baud=self._new, present=self._old)
        else:
            message = Message.of("baud_changed", baud=self._new)
        return ProcedureResult("verified", message, self._outcomes([]))

    # --- forth ---------------------------------------------------------------------------------

    def _write_all(self) -> Subprocedure[tuple[Outcome, Message] | None]:
        likely_refusals_first = sorted(self._units, key=lambda unit: self._roster[unit].link.link == "online")
        for done, unit in enumerate(likely_refusals_first):
            yield ReportProgress("sent", unit, done, len(self._units))
            sent = yield from send(Send(WriteParameterRequest(unit, BAUD_RATE, self._new // HUNDREDS)))
            if sent.refusal is not None:
                return "refused", unit_refused(unit, sent.refusal)
            if sent.status is not SendStatus.RESPONDED and not (yield from self._took_it_anyway(unit, sent)):
                return "unverified", Message.of("unit_no_acknowledgement", unit=unit)
            if self._context.cancelled:
                return "not_sent", Message("canceled")
        return None

    def _took_it_anyway(self, unit: int, sent: SendResult) -> Subprocedure[bool]:
        """Return whether a unit has the new rate although its ACK, perhaps sent at that rate, was lost."""
        if sent.attempts == 0:
            return False
        yield Retune(self._new)
        found = yield from self._responding([unit])
        yield Retune(self._old)
        return unit in found

    def _responding(self, units: Sequence[int]) -> Subprocedure[set[int]]:
        """Return those of ``units`` that respond at the present rate."""
        found: set[int] = set()
        for unit in units:
            sent = yield from send(Send(ReadStatusRequest(unit), fresh=True, max_attempts=READ_ATTEMPTS))
            if sent.status is SendStatus.RESPONDED:
                found.add(unit)
        return found

    def _disagree(self, at_old: set[int], at_new: set[int]) -> Message:
        lost = sorted(set(self._units) - at_old - at_new)
        if lost:
            return Message.of("baud_no_response", units=lost)
        return Message.of("baud_not_followed", units=sorted(at_old), baud=self._old)

    def _not_holding(self, units: Sequence[int], baud: int) -> Subprocedure[list[int]]:
        missing = []
        for unit in units:
            raw, _ = yield from read_parameter(unit, BAUD_RATE)
            if raw != baud // HUNDREDS:
                missing.append(unit)
        return missing

    # --- back ----------------------------------------------------------------------------------

    def _go_back(self, outcome: Outcome, reason: Message) -> Procedure:
        """Write every unit its old rate at whichever rate it responds; read all back at the old rate."""
        yield Retune(self._new)
        yield from self._write_old(self._units)
        yield Retune(self._old)
        yield from self._write_old(self._units)
        responding = yield from self._responding(self._units)
        missing = yield from self._not_holding(sorted(responding), self._old)
        lost = sorted({*missing, *(set(self._units) - responding)})
        yield ExpectBaud(self._old)
        if not lost:
            message = Message.of("baud_restored", reason=reason, baud=self._old)
        else:
            outcome = "unverified"
            value = self._old // HUNDREDS
            message = Message.of("baud_not_restored", reason=reason, baud=self._old, units=lost, value=value)
        return ProcedureResult(outcome, message, self._outcomes(lost))

    def _write_old(self, units: Sequence[int]) -> Subprocedure[None]:
        for unit in units:
            here = yield from self._responding([unit])
            if here:
                request = WriteParameterRequest(unit, BAUD_RATE, self._old // HUNDREDS)
                yield from send(Send(request, withdraws=True, max_attempts=READ_ATTEMPTS))

    def _outcomes(self, bad: Sequence[int]) -> list[UnitOutcome]:
        return [UnitOutcome(unit, "unverified" if unit in bad else "verified") for unit in self._units]


SHARE = 1 / 3
"""The largest part of the wire that a scan may use: polled units keep two thirds of their rate."""
OVERDUE = 3
"""The overdue responses from which on a garbled one may be one of them, collided with another."""


class ScanPace(NamedTuple):
    """The pace of a scan: the speed of the line, and the pauses that leave it to the polled units."""

    baud: int
    turnaround_s: float

    def rest_s(self, outcome: ProbeOutcome) -> float:
        """Return the pause in seconds after a request with this outcome."""
        responds = outcome.reply is not None
        took_s = wire_seconds(POLL_BYTES, self.baud) if responds else no_response_s(*self)
        return took_s * (1 / SHARE - 1)


class _LinkLostError(Exception):
    """Raised by a scan when the link to the bus is lost."""


def survey(first: int, last: int, pace: ScanPace, context: CommandContext) -> Procedure:
    """Find which of the addresses ``first`` to ``last`` respond at the bus's present rate."""
    found: list[Found] = []
    passes = Passes(range(first, last + 1))
    of = last - first + 1
    for unit in passes:
        if context.cancelled:
            return _result(found, Message.of("scan_canceled", done=passes.done, all=of))
        yield ReportProgress("searching", unit, passes.done, of)
        try:
            one = yield from _examine(unit, pace)
        except _LinkLostError:
            return _result(found, Message.of("scan_link_lost", done=passes.done, all=of))
        passes.note(found=one is not None)
        if one is not None:
            found.append(one)
    if context.overdue.total() >= OVERDUE:
        found = [_doubted(one) for one in found]
        known = {one.unit for one in found}
        late = [unit for unit in range(first, last + 1) if context.overdue[unit] and unit not in known]
        found += [Found(unit, pace.baud, "late", late=True) for unit in late]
    return _result(found, None)


def _doubted(one: Found) -> Found:
    """Reduce a finding to what is certain while responses come into the windows of other requests."""
    if one.kind == "digimax":
        return replace(one, late=True)
    return replace(one, kind="late", remarks=(), late=True)


def _result(found: list[Found], fault: Message | None) -> ProcedureResult:
    found.sort(key=lambda one: one.unit)
    return ProcedureResult(
        outcome="unverified" if fault else "verified",
        message=joined([*conclude(found), fault]),
        found=[
            FoundUnit(one.unit, one.baud, one.kind, list(one.parameters), list(one.remarks)) for one in found
        ],
    )


def _examine(unit: int, pace: ScanPace) -> Subprocedure[Found | None]:
    examination = Examination(unit, pace.baud).run()
    try:
        probe = next(examination)
        while True:
            outcome = yield from _outcome(probe)
            yield Wait(pace.rest_s(outcome))
            probe = examination.send(outcome)
    except StopIteration as end:
        found: Found | None = end.value
        return found


def _outcome(probe: Probe) -> Subprocedure[ProbeOutcome]:
    sent = yield from send(Send(probe.request, max_attempts=1, dialect=probe.dialect))
    if sent.status is SendStatus.PORT_CLOSED:
        raise _LinkLostError
    return ProbeOutcome(sent.reply, sent.noise)

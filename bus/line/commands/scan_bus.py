"""A scan of addresses on a bus that is at work, between its polls. A pure procedure.

The requests and the conclusions are those of ``bus.line.scan.examination``; only the transport differs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from bus.contract import FoundUnit
from bus.contract.durations import POLL_BYTES
from bus.line.commands.procedure import (
    CommandContext,
    Procedure,
    ProcedureResult,
    ReportProgress,
    Subprocedure,
    Wait,
    send,
)
from bus.line.exchange.send import Send, SendStatus
from bus.line.scan.examination import Examination, Probe, ProbeOutcome
from bus.line.scan.found import Found, conclude
from bus.line.scan.passes import Passes, no_response_s
from bus.messages import Message, joined
from bus.settings import wire_seconds

SHARE = 1 / 3
"""Of the wire, at most: a unit that is polled keeps two thirds of its rate."""
OVERDUE = 3
"""From this many overdue responses on, a garbled one may be one of them beside another unit's."""


class ScanPace(NamedTuple):
    """How fast the line goes, and how much of it a scan may take from the units that are polled."""

    baud: int
    turnaround_s: float

    def rest_s(self, outcome: ProbeOutcome) -> float:
        """Return the pause in seconds after a request that ended so."""
        responds = outcome.reply is not None
        took_s = wire_seconds(POLL_BYTES, self.baud) if responds else no_response_s(*self)
        return took_s * (1 / SHARE - 1)


class _LinkLostError(Exception):
    """There is no link to the bus any more."""


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
    """Reduce a finding to what is certain where responses come into the windows of other requests."""
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

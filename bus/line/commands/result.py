"""What became of a command, as the procedure that carried it out returns it."""

from __future__ import annotations

from dataclasses import dataclass

from bus.contract import Outcome, ParameterValue, UnitOutcome
from bus.line.scan.found import Found
from bus.messages import Message


@dataclass(frozen=True, slots=True)
class ProcedureResult:
    """``values`` are those that a read returned, ``found`` those of a scan.

    ``skew_s``: upper bound of the time between the first and the last unit's acting on one broadcast.
    """

    outcome: Outcome
    message: Message | None = None
    units: tuple[UnitOutcome, ...] = ()
    values: tuple[ParameterValue, ...] = ()
    found: tuple[Found, ...] = ()
    unit_error: int | None = None
    read_back: int | None = None
    skew_s: float | None = None

"""What a procedure may do (send, wait, report) and return. A procedure is a generator without clock and port.

``sent = yield Send(...)`` has one request carried out with all its attempts; ``yield Wait(...)`` lets others
use the wire; ``yield ReportProgress(...)`` reports how far it is. The line's loop runs it; a test runs it
with made-up responses.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import msgspec

from bus.contract import FoundUnit, Outcome, ParameterValue, Stage, UnitOutcome, UnitScale
from bus.line.exchange.send import Send, SendResult
from bus.messages import Message
from bus.settings import Dialect


class ProcedureResult(msgspec.Struct, frozen=True):
    """What became of a command: the fields of ``bus.contract.Result`` that a procedure knows."""

    outcome: Outcome
    message: Message | None = None
    units: list[UnitOutcome] = []
    values: list[ParameterValue] = []
    found: list[FoundUnit] = []
    unit_error: int | None = None
    read_back: int | None = None
    skew_s: float | None = None


T = TypeVar("T")


class Wait(msgspec.Struct, frozen=True):
    """Seconds in which the procedure sends nothing."""

    seconds: float


class ReportProgress(msgspec.Struct, frozen=True):
    """How far a command is."""

    stage: Stage
    unit: int | None = None
    done: int = 0
    of: int = 0


class Unstage(msgspec.Struct, frozen=True):
    """``unit`` holds no staged speed any more: it was executed, as read back, or withdrawn."""

    unit: int


class NoteStagedScale(msgspec.Struct, frozen=True):
    """The staged speed of ``unit`` was converted with ``scale``; with another it is another speed."""

    unit: int
    scale: UnitScale


class Retune(msgspec.Struct, frozen=True):
    """Everything from here on goes at ``baud``."""

    baud: int


class ExpectBaud(msgspec.Struct, frozen=True):
    """Units come up at ``baud`` once they have been switched off and on; the present rate: where they are."""

    baud: int


LineEffect = ReportProgress | Unstage | NoteStagedScale | Retune | ExpectBaud
"""What needs no waiting."""
ProcedureStep = Send | Wait | LineEffect
Subprocedure = Generator[ProcedureStep, SendResult | None, T]
"""Gets a SendResult for a Send, None for every other step."""
Procedure = Subprocedure[ProcedureResult]


@dataclass(slots=True)
class CommandContext:
    """What a procedure knows of the command it carries out, besides the action itself."""

    dialect: Dialect
    cancelled: bool = False
    """Give up at the next point where nothing is half done."""
    time_left_s: float = float("inf")
    """Until the deadline, as the procedure begins."""
    exchange_s: float = 0.02
    """What one write takes on this bus."""
    overdue: Counter[int] = field(default_factory=Counter)
    """How many responses of each unit came after their window since the command began."""
    scales: Mapping[int, UnitScale] = field(default_factory=dict)
    """By unit, what its value was converted and bounded with."""
    typed: bool = False
    """The value was typed as the unit shows it: a unit with another scale is not written."""

    def scale(self, unit: int) -> UnitScale:
        return self.scales.get(unit, {})


def send(step: Send) -> Subprocedure[SendResult]:
    """The result of one Send."""
    sent = yield step
    assert sent is not None
    return sent

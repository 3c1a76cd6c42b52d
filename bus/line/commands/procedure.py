"""A command on its way through the line, and the steps that its procedure can take: send, wait, report.

A procedure is a generator without clock and port. ``sent = yield Send(...)`` has one request carried out with
all its attempts; ``yield Wait(...)`` leaves the wire to others; ``yield ReportProgress(...)`` reports
progress. The line's loop runs it; a test runs it with made-up responses.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TypeVar

import msgspec
from msgspec.structs import asdict

from bus.contract import FoundUnit, Outcome, ParameterValue, Result, Stage, UnitOutcome, UnitScale
from bus.instants import Monotonic, UnixTime
from bus.line.send import ExchangeResult, Send, SendAttempts, SendResult
from bus.line.trace import Interpreter, TracedFrame
from bus.messages import Message
from bus.settings import Dialect
from bus.wire.commands import Request
from bus.wire.exchange import PendingResponses


class ProcedureResult(msgspec.Struct, frozen=True):
    """The result of a command: the fields of ``bus.contract.Result`` that a procedure knows."""

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
    """A pause of the procedure, in seconds."""

    seconds: float


class ReportProgress(msgspec.Struct, frozen=True):
    """A report of the stage of a command."""

    stage: Stage
    unit: int | None = None
    done: int = 0
    of: int = 0


class Unstage(msgspec.Struct, frozen=True):
    """A note that ``unit`` holds no staged speed any more: it was executed, as read back, or withdrawn."""

    unit: int


class NoteStagedScale(msgspec.Struct, frozen=True):
    """A note that the staged speed of ``unit`` was converted with ``scale``, with which alone it is valid."""

    unit: int
    scale: UnitScale


class Retune(msgspec.Struct, frozen=True):
    """A change of the port to ``baud`` for everything that follows."""

    baud: int


class ExpectBaud(msgspec.Struct, frozen=True):
    """A note that units come up at ``baud`` when they are switched off and on; the present rate ends it."""

    baud: int


LineEffect = ReportProgress | Unstage | NoteStagedScale | Retune | ExpectBaud
"""The steps that need no waiting."""
ProcedureStep = Send | Wait | LineEffect
Subprocedure = Generator[ProcedureStep, SendResult | None, T]
"""A part of a procedure. Its ``yield`` returns a SendResult for a Send, and None for every other step."""
Procedure = Subprocedure[ProcedureResult]


@dataclass(slots=True)
class CommandContext:
    """The context of a command: everything about it that its procedure knows besides the action."""

    dialect: Dialect
    cancelled: bool = False
    """Whether the procedure is to end at its next point where nothing is half done."""
    only_reads: bool = False
    """Whether a change of many units has acted and been seen to, and only reads again what proves it."""
    time_left_s: float = float("inf")
    """Seconds until the deadline, counted when the command was submitted."""
    exchange_s: float = 0.02
    """The seconds that one write takes on this bus."""
    overdue: Counter[int] = field(default_factory=Counter)
    """The number of responses of each unit that came after their window since the command began."""
    scales: Mapping[int, UnitScale] = field(default_factory=dict)
    """The raw scale parameters of each unit with which its value was converted and bounded."""
    typed: bool = False
    """Whether the value was typed as the unit shows it: a unit with another scale is then not written."""

    def scale(self, unit: int) -> UnitScale:
        return self.scales.get(unit, {})


def send(step: Send) -> Subprocedure[SendResult]:
    """Carry out one Send and return its result."""
    sent = yield step
    assert sent is not None
    return sent


class Priority(IntEnum):
    """The priority of a command; the lowest number goes first."""

    WRITE = 0
    READ = 1
    SLOW = 2
    """The priority of a command that is sent only in the gaps of the scan."""


EVERY_UNIT = frozenset(range(256))
NO_UNIT: frozenset[int] = frozenset()


@dataclass(eq=False)
class CommandRun:
    """A command on its way: ``begin`` makes its procedure in its turn; no other may write to ``units``."""

    id: str
    priority: Priority
    units: frozenset[int]
    deadline: Monotonic
    """The deadline by the line's clock."""
    context: CommandContext
    begin: Callable[[], Procedure]
    on_effect: Callable[[LineEffect], None]
    """Called with each step of the procedure that is no request and no pause."""
    frames: list[TracedFrame] = field(default_factory=list)
    resume_at: Monotonic = Monotonic(0.0)
    result: ProcedureResult | None = None
    attempts: SendAttempts | None = None
    _procedure: Procedure | None = None

    @property
    def begun(self) -> bool:
        """Whether the turn of the command has come."""
        return self._procedure is not None

    def next_request(self, now: Monotonic, pending_of: Callable[[int], PendingResponses]) -> Request | None:
        """Return the request to send now; None while the command waits, and once it has a result."""
        while self.result is None:
            if self.attempts is not None:
                request = self.attempts.next_request(now, pending_of(self.attempts.send.request.unit))
                if request is not None:
                    return request
            elif now < self.resume_at:
                return None
            self._advance(now)
        return None

    def settle(self, exchange: ExchangeResult, now: Monotonic) -> bool:
        """Take the result of an exchange; return whether its request is repeated, as nothing responded."""
        assert self.attempts is not None
        again = self.attempts.settle(exchange)
        if self.attempts.result is not None:
            self._advance(now)
        return again

    def close(self, now: Monotonic) -> None:
        """End every request of the command, because the port is gone."""
        while self.result is None:
            if self.attempts is not None:
                self.attempts.close()
            self._advance(now)

    def end(self, result: ProcedureResult) -> None:
        """End the command before its procedure has ended."""
        if self._procedure is not None:
            self._procedure.close()
        self.result = result
        self.attempts = None

    def report(self, at: UnixTime, dialect: Dialect) -> Result:
        """Return the result of the command, with the frames that carried it."""
        assert self.result is not None
        interpreter = Interpreter(dialect)
        frames = [interpreter.frame(passed) for passed in self.frames]
        return Result(self.id, at, **asdict(self.result), frames=frames)

    def _advance(self, now: Monotonic) -> None:
        """Run the procedure to its next request, its next pause or its end."""
        if self._procedure is None:
            self._procedure = self.begin()
        attempts, self.attempts = self.attempts, None
        try:
            step = self._procedure.send(attempts.result if attempts is not None else None)
            while isinstance(step, LineEffect):
                self.on_effect(step)
                step = self._procedure.send(None)
        except StopIteration as end:
            self.result = end.value
            return
        if isinstance(step, Send):
            self.attempts = SendAttempts(step, self.deadline)
        elif isinstance(step, Wait):
            self.resume_at = now + step.seconds

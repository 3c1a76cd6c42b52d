"""One command on its way through the line: a procedure, its request, its result. No clock, no port."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

from msgspec.structs import asdict

from bus.contract import Result
from bus.instants import Monotonic, UnixTime
from bus.line.commands.procedure import CommandContext, LineEffect, Procedure, ProcedureResult, Wait
from bus.line.exchange.send import ExchangeResult, Send, SendAttempts
from bus.line.statistics.trace import Interpreter, TracedFrame
from bus.settings import Dialect
from bus.wire.commands import Request
from bus.wire.fence import PendingResponses


class Priority(IntEnum):
    """Which command comes first."""

    WRITE = 0
    READ = 1
    SLOW = 2
    """Only in the gaps of the scan."""


EVERY_UNIT = frozenset(range(256))
NO_UNIT: frozenset[int] = frozenset()


@dataclass(eq=False)
class CommandRun:
    """``begin`` makes the procedure when its turn has come. ``units``: no other command may write to them."""

    id: str
    priority: Priority
    units: frozenset[int]
    deadline: Monotonic
    """On the line's clock."""
    context: CommandContext
    begin: Callable[[], Procedure]
    on_effect: Callable[[LineEffect], None]
    """Called with what the procedure does beside its requests."""
    frames: list[TracedFrame] = field(default_factory=list)
    resume_at: Monotonic = Monotonic(0.0)
    result: ProcedureResult | None = None
    attempts: SendAttempts | None = None
    _procedure: Procedure | None = None

    @property
    def begun(self) -> bool:
        """Whether its turn has come."""
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
        """Take the result of its exchange; return whether the request is sent again, as nothing responded."""
        assert self.attempts is not None
        again = self.attempts.settle(exchange)
        if self.attempts.result is not None:
            self._advance(now)
        return again

    def close(self, now: Monotonic) -> None:
        """The port is gone: every request of it ends so."""
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

"""One command on its way through the line: a procedure, its present question, its fate. No clock, no port."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

from bus.contract import Result
from bus.line.commands.procedure import Answer, Ask, Note, Procedure, Wait, Wish
from bus.line.exchange.attempts import Asking, Heard
from bus.line.statistics.trace import Passed
from bus.wire.commands import Request
from bus.wire.fence import Doubt


class Claim(IntEnum):
    """Who comes first."""

    WRITE = 0
    READ = 1
    SLOW = 2
    """Only in the gaps of the scan."""


EVERY_UNIT = frozenset(range(256))
NO_UNIT: frozenset[int] = frozenset()


@dataclass(eq=False)
class Errand:
    """``begin`` makes the procedure when its turn has come. ``units``: those nobody else may write to."""

    id: str
    claim: Claim
    units: frozenset[int]
    deadline: float
    """On the line's clock."""
    wish: Wish
    begin: Callable[[], Procedure]
    notes: Callable[[Note], None]
    """Hears what the procedure tells on its way."""
    frames: list[Passed] = field(default_factory=list)
    resume_at: float = 0.0
    result: Result | None = None
    asking: Asking | None = None
    _procedure: Procedure | None = None

    @property
    def begun(self) -> bool:
        """Whether its turn has come."""
        return self._procedure is not None

    def conflicts_with(self, other: Errand) -> bool:
        """Whether the two must not be mixed."""
        return not self.units.isdisjoint(other.units)

    def next_request(self, now: float, doubt_of: Callable[[int], Doubt]) -> Request | None:
        """What it wants sent now; None while it waits, and once ``result`` is there."""
        if self._procedure is None:
            self._procedure = self.begin()
            self._advance(None, now)
        while self.result is None:
            if self.asking is None:
                if now < self.resume_at:
                    return None
                self._advance(None, now)
                continue
            request = self.asking.next_request(now, doubt_of(self.asking.ask.request.unit))
            if request is not None:
                return request
            self._advance(self._taken_answer(), now)
        return None

    def settle(self, heard: Heard, now: float) -> bool:
        """Its exchange is over; whether it is tried again, as nobody answered."""
        assert self.asking is not None
        again = self.asking.settle(heard)
        if self.asking.answer is not None:
            self._advance(self._taken_answer(), now)
        return again

    def close(self, now: float) -> None:
        """The port is gone: every question of it ends so."""
        while self.result is None:
            if self._procedure is None:
                self._procedure = self.begin()
                self._advance(None, now)
            elif self.asking is not None:
                self.asking.close()
                self._advance(self._taken_answer(), now)
            else:
                self._advance(None, now)

    def end(self, result: Result) -> None:
        """It is over before its procedure is."""
        if self._procedure is not None:
            self._procedure.close()
        self.result = result
        self.asking = None

    def _taken_answer(self) -> Answer | None:
        assert self.asking is not None
        answer, self.asking = self.asking.answer, None
        return answer

    def _advance(self, answer: Answer | None, now: float) -> None:
        """Run the procedure to its next question, its next pause or its end."""
        assert self._procedure is not None
        try:
            step = self._procedure.send(answer)
            while isinstance(step, Note):
                self.notes(step)
                step = self._procedure.send(None)
        except StopIteration as end:
            self.result = end.value
            return
        if isinstance(step, Ask):
            self.asking = Asking(step, self.deadline)
        elif isinstance(step, Wait):
            self.resume_at = now + step.seconds

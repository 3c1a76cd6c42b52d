"""One question through all its tries: fences, retries, deadline. Pure: time in seconds is passed in."""

from __future__ import annotations

import msgspec

from bus.line.commands.procedure import NO_RUBBISH, Answer, Ask, Fate, Rubbish
from bus.settings import Dialect
from bus.wire.commands import Reply, Request, is_write
from bus.wire.fence import Doubt

MOST_FENCES = 8
"""Fences that are answered, each before a try that is not: such a unit hears one frame in two."""


class Heard(msgspec.Struct, frozen=True):
    """How one exchange ended. Times: seconds since the epoch; ``reply`` None: no answer in its window."""

    request: Request
    reply: Reply | None
    sent_at: float
    answered_at: float | None = None
    frame: bytes = b""
    rubbish: Rubbish = NO_RUBBISH
    dialect: Dialect | None = None
    """How the request was written, where something was sent."""


class Asking:
    """``next_request`` and ``settle`` in turn, until ``answer`` is there.

    A timeout of a fence counts like a timeout of the request: so many in a row mean silence. A write never
    leaves after ``deadline`` (on the clock of ``now``), whatever came of its earlier tries.
    """

    def __init__(self, ask: Ask, deadline: float = float("inf")) -> None:
        self.ask = ask
        self.answer: Answer | None = None
        self._deadline = float("inf") if ask.withdraws or not is_write(ask.request) else deadline
        self._attempts = 0
        self._fences = 0
        self._unanswered = 0
        self._sent_at: float | None = None
        self._rubbish = NO_RUBBISH

    @property
    def begun(self) -> bool:
        """Whether the request itself has left."""
        return self._attempts > 0

    def dialect_of(self, request: Request) -> Dialect | None:
        """How ``request`` is written, where not as the bus does."""
        return self.ask.dialect if request == self.ask.request else None

    def tells_of(self, request: Request) -> bool:
        """Whether it is told that ``request`` leaves: the first time only, and not for a fence."""
        return self.ask.tells and not self.begun and request == self.ask.request

    def next_request(self, now: float, doubt: Doubt) -> Request | None:
        """What to send now; None once ``answer`` is there. ``doubt``: of the unit asked."""
        if self.answer is not None:
            return None
        fence = self._fence(doubt)
        if fence is not None:
            return fence
        if now > self._deadline:
            self._end(Fate.TOO_LATE)
            return None
        return self.ask.request

    def settle(self, heard: Heard) -> bool:
        """What ``next_request`` gave has passed; whether it is tried again, as nobody answered."""
        if heard.request != self.ask.request:
            self._rubbish = heard.rubbish
            self._settle_fence(answered=heard.reply is not None)
        else:
            self._settle_request(heard)
        return self.answer is None and heard.reply is None

    def _settle_request(self, heard: Heard) -> None:
        self._attempts += 1
        self._sent_at = heard.sent_at
        if heard.request.unit == 0:
            self._end(Fate.SENT)
        elif heard.reply is not None:
            self._end(Fate.ANSWERED, heard)
        else:
            self._rubbish = heard.rubbish
            self._missed()

    def close(self) -> None:
        """The port is gone."""
        if self.answer is None:
            self._end(Fate.CLOSED)

    def _fence(self, doubt: Doubt) -> Request | None:
        """A retry may take the answer to the try before, as it is hardly older. A later question may not:
        an answer that a buffer on the way kept for seconds would be shown as new."""
        fence = doubt.fence_before(self.ask.request)
        fresh = self.ask.proves or not self.begun
        if fence is None and fresh and self.ask.request in doubt.outstanding:
            fence = doubt.fence()
        return fence if fence != self.ask.request else None

    def _settle_fence(self, *, answered: bool) -> None:
        if answered:
            self._unanswered = 0
            self._fences += 1
            if self._fences > MOST_FENCES:
                self._end(Fate.SILENT)
        else:
            self._missed()

    def _missed(self) -> None:
        self._unanswered += 1
        if self._unanswered >= self.ask.tries or self._attempts >= self.ask.tries:
            self._end(Fate.SILENT)

    def _end(self, fate: Fate, heard: Heard | None = None) -> None:
        reply = heard.reply if heard is not None else None
        answered_at = heard.answered_at if heard is not None else None
        frame = heard.frame if heard is not None else b""
        rubbish = heard.rubbish if heard is not None else self._rubbish
        self.answer = Answer(fate, reply, self._attempts, self._sent_at, answered_at, frame, rubbish)

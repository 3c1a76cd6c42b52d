"""What a procedure may do: ask, wait, tell. A procedure is a generator, so it knows no clock and no port.

``answer = yield Ask(...)`` has one request carried out with all its tries; ``yield Wait(...)`` lets others
use the wire; ``yield Tell(...)`` says how far it is. The poller runs it (``bus.line.poller``); a test runs
it with made-up answers.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from enum import StrEnum

import msgspec

from bus.contract import Result, Stage
from bus.settings import Dialect
from bus.wire.commands import Nak, Reply, Request, is_write

READ_TRIES = 3
WRITE_TRIES = 4
"""The first and two more for a read, three more for a write."""


class Ask(msgspec.Struct, frozen=True):
    """One request and its answer. ``proves``: only an answer that nothing older can be taken for.

    ``withdraws``: a write that puts back what a change has staged; it may leave after the deadline.
    """

    request: Request
    proves: bool = False
    withdraws: bool = False
    most_tries: int = 0
    dialect: Dialect | None = None
    """How to write it, where not as the bus does."""
    tells: bool = False
    """That it has left is told as the stage "sent"."""

    @property
    def tries(self) -> int:
        """How often it is sent at most."""
        return self.most_tries or (WRITE_TRIES if is_write(self.request) else READ_TRIES)


class Wait(msgspec.Struct, frozen=True):
    """Seconds in which the procedure wants nothing."""

    seconds: float


class Tell(msgspec.Struct, frozen=True):
    """How far a command is."""

    stage: Stage
    unit: int | None = None
    done: int = 0
    of: int = 0


class Unstage(msgspec.Struct, frozen=True):
    """``unit`` holds no staged speed any more: it was executed, as proven, or withdrawn."""

    unit: int


class Retune(msgspec.Struct, frozen=True):
    """Everything from here on goes at ``baud``."""

    baud: int


class Expect(msgspec.Struct, frozen=True):
    """Units come up at ``baud`` once they have been switched off and on; the present rate: where they are."""

    baud: int


class Rubbish(msgspec.Struct, frozen=True):
    """What else came in while an answer was awaited."""

    spoilt: bool = False
    """Bytes that are no frame."""
    strange: bool = False
    """Good frames that no unit gives as this answer."""


NO_RUBBISH = Rubbish()


class Fate(StrEnum):
    """How an Ask ended."""

    ANSWERED = "answered"
    SENT = "sent"
    """A broadcast, which nobody answers, has left."""
    SILENT = "silent"
    TOO_LATE = "too late"
    """The deadline passed before it could leave (again)."""
    CLOSED = "closed"
    """There is no link to the bus."""


class Answer(msgspec.Struct, frozen=True):
    """What an Ask led to. Times: seconds since the epoch. ``attempts``: how often the request left."""

    fate: Fate
    reply: Reply | None = None
    attempts: int = 0
    sent_at: float | None = None
    """The request's last byte on the wire."""
    answered_at: float | None = None
    frame: bytes = b""
    rubbish: Rubbish = NO_RUBBISH

    @property
    def refusal(self) -> int | None:
        """The unit's error code where it said NAK."""
        return self.reply.code if isinstance(self.reply, Nak) else None

    @property
    def may_have_acted(self) -> bool:
        """Whether a write may have been carried out: a NAK speaks for its own try, not for an earlier one
        whose answer was lost."""
        return self.attempts > 1 or (self.attempts == 1 and self.refusal is None)


Note = Tell | Unstage | Retune | Expect
"""What needs no waiting."""
Step = Ask | Wait | Note
Procedure = Generator[Step, Answer | None, Result]
"""Gets an Answer for an Ask, None for every other step."""


@dataclass(slots=True)
class Wish:
    """What a procedure is told of the command it carries out, besides the action itself."""

    dialect: Dialect
    cancelled: bool = False
    """Give up at the next point where nothing is half done."""
    time_left_s: float = float("inf")
    """Until the deadline, as the procedure begins."""
    exchange_s: float = 0.02
    """What one write takes on this bus."""

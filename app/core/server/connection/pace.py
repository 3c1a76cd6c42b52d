"""Limits how long the other end of a connection may take. Pure: times are seconds on any steady clock."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

MIN_RATE = 1000.0
"""Bytes a second, of a body that arrives and of a response that is read. A modem makes three times that."""
STALL_S = 20.0
"""Over which the rate of a reader is measured."""


class Awaited(Enum):
    """What the client of an HTTP connection owes."""

    FIRST = auto()
    """The first request; a browser may open a connection ahead of it."""
    HEAD = auto()
    """The rest of the headers of a request that has begun."""
    BODY = auto()
    NOTHING = auto()
    """It is the server's turn."""
    NEXT = auto()
    """Another request, or the end."""


WITHIN_S = {Awaited.FIRST: 20.0, Awaited.HEAD: 20.0, Awaited.BODY: 20.0, Awaited.NEXT: 5.0}
"""For a body this is how long it may fall behind the least rate."""
MAX_BODY_S = 300.0
PROMPT_S = 0.25
"""A client that has just connected sends its request in the next moment."""


@dataclass(slots=True)
class Pace:
    """The part that is awaited, since when, and how many of its bytes have arrived."""

    since: float
    awaited: Awaited = Awaited.FIRST
    received: int = 0

    def expect(self, awaited: Awaited, now: float) -> None:
        """Await this part from now on."""
        self.awaited, self.since, self.received = awaited, now, 0

    def is_idle(self, now: float) -> bool:
        """Whether the client keeps the server waiting."""
        return self.awaited is not Awaited.NOTHING and now - self.since > PROMPT_S

    def is_overdue(self, now: float) -> bool:
        """Whether the client has taken too long."""
        if self.awaited is Awaited.NOTHING:
            return False
        earned_s = self.received / MIN_RATE if self.awaited is Awaited.BODY else 0.0
        return now - self.since > min(WITHIN_S[self.awaited] + earned_s, MAX_BODY_S)


@dataclass(slots=True)
class Backlog:
    """What was written and waits for the client to read it."""

    size: int = 0
    since: float = 0.0

    def is_stuck(self, size: int, now: float) -> bool:
        """Whether too little was read since the window began. ``size``: bytes that wait now, to which nothing
        was added since the call before; or 0."""
        if not size or not self.size:
            self.size, self.since = size, now
            return False
        if now - self.since < STALL_S:
            return False
        was_read = self.size - size
        self.size, self.since = size, now
        return was_read < MIN_RATE * STALL_S

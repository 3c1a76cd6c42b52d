"""A request with all its attempts, as a procedure orders it, and what became of it."""

from __future__ import annotations

from enum import StrEnum

import msgspec

from bus.instants import UnixTime
from bus.settings import Dialect
from bus.wire.commands import Nak, Reply, Request, is_write

READ_ATTEMPTS = 3
WRITE_ATTEMPTS = 4
"""The first and two more for a read, three more for a write."""


class Send(msgspec.Struct, frozen=True):
    """One request and its response. ``fresh``: only a response that nothing older can be taken for.

    ``withdraws``: a write that puts back what a change has staged; it may leave after the deadline.
    """

    request: Request
    fresh: bool = False
    withdraws: bool = False
    max_attempts: int = 0
    dialect: Dialect | None = None
    """How to encode it, where not as the bus does."""
    reports_sent: bool = False
    """Its first departure is reported as the stage "sent"."""

    @property
    def attempts_allowed(self) -> int:
        """How often it is sent at most."""
        return self.max_attempts or (WRITE_ATTEMPTS if is_write(self.request) else READ_ATTEMPTS)


class LineNoise(msgspec.Struct, frozen=True):
    """What else came in while a response was awaited."""

    garbled: bool = False
    """Bytes that are no frame."""
    unexpected: bool = False
    """Good frames that no unit gives as this response."""
    late: int = 0
    """Good frames of the unit beside the response: responses to earlier requests, or a second copy."""


NO_NOISE = LineNoise()


class SendStatus(StrEnum):
    """How a Send ended."""

    RESPONDED = "responded"
    SENT = "sent"
    """A broadcast, to which no unit responds, has left."""
    TIMED_OUT = "timed out"
    TOO_LATE = "too late"
    """The deadline passed before it could leave (again)."""
    PORT_CLOSED = "port closed"


class SendResult(msgspec.Struct, frozen=True):
    """What a Send led to. Times: seconds since the epoch. ``attempts``: how often the request left."""

    status: SendStatus
    reply: Reply | None = None
    attempts: int = 0
    sent_at: UnixTime | None = None
    """The request's last byte on the wire."""
    responded_at: UnixTime | None = None
    frame: bytes = b""
    noise: LineNoise = NO_NOISE

    @property
    def refusal(self) -> int | None:
        """The unit's error code where it responded with NAK."""
        return self.reply.code if isinstance(self.reply, Nak) else None

    @property
    def may_have_acted(self) -> bool:
        """Whether a write may have been carried out: a NAK speaks for its own attempt, not for an earlier one
        whose response was lost."""
        return self.attempts > 1 or (self.attempts == 1 and self.refusal is None)

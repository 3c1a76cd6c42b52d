"""A request through all its attempts: fences, retries, deadline, result. Pure: time is passed in."""

from __future__ import annotations

from enum import StrEnum

import msgspec
from msgspec.structs import replace

from bus.instants import Monotonic, UnixTime
from bus.line.timing import NEVER
from bus.settings import Dialect
from bus.wire.commands import Nak, Reply, Request, is_write
from bus.wire.exchange import PendingResponses

READ_ATTEMPTS = 3
WRITE_ATTEMPTS = 4
"""The most attempts of a read and of a write, the first included."""


class Send(msgspec.Struct, frozen=True):
    """A request and its response. ``fresh``: only a response that cannot be confused with an older one
    counts. ``withdraws``: a write that takes back a staged speed; it may leave after the deadline."""

    request: Request
    fresh: bool = False
    withdraws: bool = False
    max_attempts: int = 0
    dialect: Dialect | None = None
    """The dialect in which to encode the request; None for that of the bus."""
    reports_sent: bool = False
    """Whether the first time that it leaves is reported as the stage "sent"."""

    @property
    def attempts_allowed(self) -> int:
        """The most times that the request is sent."""
        return self.max_attempts or (WRITE_ATTEMPTS if is_write(self.request) else READ_ATTEMPTS)


class LineNoise(msgspec.Struct, frozen=True):
    """Everything else that came in while a response was awaited."""

    garbled: bool = False
    """Whether bytes came that are not a frame."""
    unexpected: bool = False
    """Whether valid frames came that no unit gives as this response."""
    late: int = 0
    """Valid frames of the unit beside the response: responses to earlier requests, or a second copy."""


NO_NOISE = LineNoise()


class SendStatus(StrEnum):
    """The way in which a Send ended."""

    RESPONDED = "responded"
    SENT = "sent"
    """The request was a broadcast, to which no unit responds, and has left."""
    TIMED_OUT = "timed out"
    TOO_LATE = "too late"
    """The deadline passed before the request could leave (again)."""
    PORT_CLOSED = "port closed"


class SendResult(msgspec.Struct, frozen=True):
    """The result of a Send. Times: seconds since the epoch. ``attempts``: how often the request left."""

    status: SendStatus
    reply: Reply | None = None
    attempts: int = 0
    sent_at: UnixTime | None = None
    """The time when the request's last byte left."""
    responded_at: UnixTime | None = None
    frame: bytes = b""
    noise: LineNoise = NO_NOISE

    @property
    def refusal(self) -> int | None:
        """The unit's error code if it responded with NAK."""
        return self.reply.code if isinstance(self.reply, Nak) else None

    @property
    def acknowledged(self) -> bool:
        """Whether the unit responded, and not with NAK."""
        return self.status is SendStatus.RESPONDED and self.refusal is None

    @property
    def may_have_acted(self) -> bool:
        """Whether a write may have been carried out: a NAK speaks for its own attempt, not for an earlier one
        whose response was lost."""
        return self.attempts > 1 or (self.attempts == 1 and self.refusal is None)


MAX_FENCES = 8
"""The most responses to fences before attempts without one: such a unit receives every other frame."""


class ExchangeResult(msgspec.Struct, frozen=True):
    """The result of one exchange. ``reply`` None: no response in its window. ``began`` and ``ended`` are the
    line's own time, ``sent_at`` and ``responded_at`` Unix time, in seconds."""

    request: Request
    reply: Reply | None
    began: Monotonic
    ended: Monotonic
    sent_at: UnixTime
    """The time when the request's last byte left."""
    responded_at: UnixTime | None = None
    frame: bytes = b""
    noise: LineNoise = NO_NOISE
    dialect: Dialect | None = None
    """The dialect in which the request was encoded."""
    overdue: tuple[int, ...] = ()
    """Units whose response to an earlier request came, once for each response."""


class SendAttempts:
    """The attempts of one Send: call ``next_request`` and ``settle`` in turn, until there is a ``result``.

    A timeout of a fence counts like a timeout of the request: so many in a row mean no response. A write
    never leaves after ``deadline`` (on the clock of ``now``), whatever the outcome of its earlier attempts.
    """

    def __init__(self, send: Send, deadline: Monotonic = NEVER) -> None:
        self.send = send
        self.result: SendResult | None = None
        self._deadline = NEVER if send.withdraws or not is_write(send.request) else deadline
        self._attempts = 0
        self._fences = 0
        self._without_response = 0
        self._sent_at: UnixTime | None = None
        self._noise = NO_NOISE
        self._late = 0

    @property
    def begun(self) -> bool:
        """Whether the request itself has left."""
        return self._attempts > 0

    def dialect_of(self, request: Request) -> Dialect | None:
        """Return the dialect in which ``request`` is encoded, or None for that of the bus."""
        return self.send.dialect if request == self.send.request else None

    def reports(self, request: Request) -> bool:
        """Return whether the sending of ``request`` is reported: the first time only, and not for a fence."""
        return self.send.reports_sent and not self.begun and request == self.send.request

    def next_request(self, now: Monotonic, pending: PendingResponses) -> Request | None:
        """Return what to send now; None once there is a ``result``. ``pending``: of the addressed unit."""
        if self.result is not None:
            return None
        fence = self._fence(pending)
        if fence is not None:
            return fence
        if now > self._deadline:
            self._end(SendStatus.TOO_LATE)
            return None
        return self.send.request

    def settle(self, exchange: ExchangeResult) -> bool:
        """Take the exchange of the last request; return whether it is repeated for lack of a response."""
        self._noise = exchange.noise
        self._late += exchange.noise.late
        is_fence = exchange.request != self.send.request
        if not is_fence:
            self._attempts += 1
            self._sent_at = exchange.sent_at
        if exchange.request.unit == 0:
            self._end(SendStatus.SENT)
        elif exchange.reply is None:
            self._without_response += 1
            if max(self._without_response, self._attempts) >= self.send.attempts_allowed:
                self._end(SendStatus.TIMED_OUT)
        elif is_fence:
            self._without_response = 0
            self._fences += 1
            if self._fences > MAX_FENCES:
                self._end(SendStatus.TIMED_OUT)
        else:
            self._end(SendStatus.RESPONDED, exchange)
        return self.result is None and exchange.reply is None

    def close(self) -> None:
        """End the request, because the port is gone."""
        if self.result is None:
            self._end(SendStatus.PORT_CLOSED)

    def _fence(self, pending: PendingResponses) -> Request | None:
        """Return the fence that must go first, if any. A repeated request may take the response to its
        attempt before, which is hardly older; a later request may not, because a response that a buffer on
        the way kept for seconds would be shown as new."""
        fence = pending.fence_before(self.send.request)
        fresh = self.send.fresh or not self.begun
        if fence is None and fresh and self.send.request in pending.outstanding:
            fence = pending.fence()
        return fence if fence != self.send.request else None

    def _end(self, status: SendStatus, response: ExchangeResult | None = None) -> None:
        noise = replace(self._noise, late=self._late)
        result = SendResult(status, attempts=self._attempts, sent_at=self._sent_at, noise=noise)
        if response is not None:
            reply, frame = response.reply, response.frame
            result = replace(result, reply=reply, responded_at=response.responded_at, frame=frame)
        self.result = result

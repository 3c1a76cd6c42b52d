"""One request and its response as a state machine: bytes in, events out. It has no clock.

================  =============================  ==========================================
while             a good frame arrives           event
================  =============================  ==========================================
at any time       equal to our own request       Echo (a half-duplex adapter echoes)
at any time       another address                Foreign
awaiting          right address, wrong shape     Unexpected
awaiting          fits, but may be a late one    Late (see ``fence``)
awaiting          fits                           Responded; nothing is awaited any more
responded         the same bytes a second time   Duplicate
responded or      right address                  Late
timed out
================  =============================  ==========================================

Bytes that are no good frame pass through as the Noise that framing made of them; a Noise with
``Fault.CHECKSUM`` while awaiting is most likely the damaged response.
"""

from __future__ import annotations

import msgspec

from bus.instants import Monotonic
from bus.settings import Dialect
from bus.wire.commands import Reply, Request, is_secret, parse_reply, request_body
from bus.wire.fence import PendingResponses
from bus.wire.framing import DoubledChecksum, FrameDecoder, Noise, ReceivedFrame, encode_frame


class Responded(msgspec.Struct, frozen=True):
    """The response to the request."""

    reply: Reply
    frame: ReceivedFrame


class _WithFrame(msgspec.Struct, frozen=True):
    frame: ReceivedFrame


class Foreign(msgspec.Struct, frozen=True):
    """A good frame with an address other than that of the request."""

    unit: int
    frame: ReceivedFrame


class Echo(_WithFrame, frozen=True):
    """Our own request came back."""


class Unexpected(_WithFrame, frozen=True):
    """A good frame of the addressed unit that is no response to this command."""


class Late(_WithFrame, frozen=True):
    """A good frame of the unit that belongs, or may belong, to an earlier request."""


class Duplicate(_WithFrame, frozen=True):
    """A duplicate of the response already taken."""


ExchangeEvent = Responded | Foreign | Echo | Unexpected | Late | Duplicate | Noise | DoubledChecksum


class Exchange:
    """A request and what comes back.

    ``decoder`` is that of the previous exchange where its bytes may still arrive; the default is a new one.
    ``pending`` holds the late responses that the unit may still send, by default none. Raises CallerError for
    a request that must not be sent.
    """

    def __init__(
        self,
        request: Request,
        dialect: Dialect,
        *,
        decoder: FrameDecoder | None = None,
        pending: PendingResponses | None = None,
    ) -> None:
        self.request = request
        self._body = request_body(request, dialect)
        self.sent = encode_frame(self._body, dialect)
        self.secret = is_secret(request)
        self.decoder = decoder or FrameDecoder(dialect)
        self.awaiting = request.unit != 0
        self.reply: Reply | None = None
        self.first_byte_at: Monotonic | None = None
        """When the first byte after the request (and its echo) came, in the caller's time."""
        self.dialect = dialect
        self._before = pending or PendingResponses(request.unit, dialect)
        self.frame = b""
        """The response as it was on the wire."""
        self.pending = self._before.sent(request)
        """The late responses that the unit may still send once this exchange is over."""

    def receive(self, data: bytes, at: Monotonic) -> list[ExchangeEvent]:
        """Take bytes that came in at ``at``, in pieces of any size, and return the events."""
        if data and self.first_byte_at is None:
            self.first_byte_at = at
        events: list[ExchangeEvent] = []
        for received in self.decoder.feed(data):
            event = self._classify(received) if isinstance(received, ReceivedFrame) else received
            if isinstance(event, Echo):
                self.first_byte_at = None
            elif self.first_byte_at is None:
                self.first_byte_at = at
            events.append(event)
        if self.decoder.pending and self.first_byte_at is None:
            self.first_byte_at = at
        return events

    def response_began(self, ended: Monotonic, byte_s: float) -> Monotonic:
        """Return when the response began that was complete at ``ended``; a byte takes ``byte_s`` seconds.

        A first byte that an adapter held back came earlier than it was read.
        """
        begins = ended - len(self.frame) * byte_s
        return begins if self.first_byte_at is None else min(begins, self.first_byte_at - byte_s)

    def give_up(self) -> None:
        """Take whatever comes from now on for late, because the deadline has passed."""
        self.awaiting = False

    def _classify(self, frame: ReceivedFrame) -> ExchangeEvent:
        if frame.body == self._body:
            return Echo(frame)
        unit = frame.body[0]
        if unit != self.request.unit:
            return Foreign(unit, frame)
        # A duplicate response is not evidence of a second request.
        if not self.awaiting and frame.wire == self.frame:
            return Duplicate(frame)
        self.pending = self.pending.received(frame.body)
        return self._judge(frame) if self.awaiting else Late(frame)

    def _judge(self, frame: ReceivedFrame) -> ExchangeEvent:
        reply = parse_reply(self.request, frame.body, self.dialect)
        if reply is None:
            return Unexpected(frame)
        if not self._before.believes(self.request, frame.body):
            self._before = self._before.received(frame.body)
            return Late(frame)
        self.awaiting = False
        self.reply = reply
        self.frame = frame.wire
        return Responded(reply, frame)

"""One request and its response as a state machine: bytes in, events out. It has no clock.

================  =============================  ==========================================
while             a good frame arrives           event
================  =============================  ==========================================
at any time       equal to our own request       Echo (a half-duplex adapter echoes)
at any time       another address                Foreign
awaiting          right address, wrong shape     Unexpected
awaiting          fits, but may be a late one    Late (see the fence)
awaiting          fits                           Responded; nothing is awaited any more
responded         the same bytes a second time   Duplicate
responded or      right address                  Late
timed out
================  =============================  ==========================================

Bytes that are no good frame pass through as the Noise that framing made of them; a Noise with
``Fault.CHECKSUM`` while awaiting is most likely the damaged response.

The fence: which responses can still be late, and which read must go first before the next response can be
trusted.

A response names its unit and nothing else: neither the command nor the parameter. After a timeout the
response may be lost or on its way, and on its way it could pass for the response to the next request. The
same is true of a duplicate.

A response can be identified only by its *shape*: ACK with a number of data bytes, or NAK with an error code.
The rules:

1. Every request that was sent and has no certain response is *outstanding*, oldest first. A unit responds in
   order, so a response ends all that was outstanding before the first request that can have caused it.
2. The *last* response of a unit may be duplicated, but only while the very next request is under way.
3. A response is believed only if nothing outstanding, nor the last one, can be its cause. The one exception
   is the same read sent again with no write between, because its late response has the same content. The same
   write sent again is no exception: a late refusal of the first is none of the second.
4. A request needs a fence first when its ordinary responses are among those that may be late or duplicated.
   The fence is 81h or 85h, whichever leaves less outstanding: their responses have 11 and at most 4 data
   bytes, those to writes have none (86h: at most 4).

After a lost 81h, any write or 85h may follow at once. After a lost write, 81h may, and 85h too, except after
86h. After a lost 85h, another 85h or an 86h needs 81h before it; after a lost write, another write does. The
same holds directly after a response, at the price of an 81h that would soon be due anyway. "Illegal command"
(86h, 89h) can be the response to anything, so it is no ordinary response: a unit that knows the commands does
not send it, and where it is ambiguous it is not believed.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import msgspec

from bus.catalogue.parameters import OWN_ADDRESS
from bus.errors import UnitErrorCode
from bus.instants import Monotonic
from bus.settings import Dialect
from bus.wire.commands import (
    TRAITS,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    acknowledged_lengths,
    is_secret,
    is_write,
    parse_reply,
    request_body,
)
from bus.wire.framing import ACK, NAK, DoubledChecksum, FrameDecoder, Noise, ReceivedFrame, encode_frame

LONG_RUN = 3
"""The number of equal reads in a row beyond which more of them make no difference."""
MAX_OUTSTANDING = 32
"""The most outstanding requests to one unit; a response that is late by more is not expected."""

MAX_FENCES_PLANNED = 4
"""The most fences that are planned ahead; each may double the states to look at."""


class Shape(NamedTuple):
    """ACK and the number of data bytes, or NAK and the error code."""

    mark: int
    detail: int


_ILLEGAL_COMMAND = frozenset(
    (Shape(NAK, UnitErrorCode.ILLEGAL_COMMAND), Shape(NAK, UnitErrorCode.ILLEGAL_COMMAND_DFS))
)


def shape_of(body: bytes) -> Shape | None:
    """Return the shape of a unit's response; None for a body that no response has."""
    if len(body) == 3 and body[1] == NAK:
        return Shape(NAK, body[2])
    if len(body) >= 2 and body[1] == ACK:
        return Shape(ACK, len(body) - 2)
    return None


def ordinary_shapes(request: Request, dialect: Dialect) -> frozenset[Shape]:
    """Return the shapes that the manual gives, without "illegal command"; none for a broadcast."""
    if request.unit == 0:
        return frozenset()
    return _ordinary(request.COMMAND, acknowledged_lengths(request, dialect))


def possible_shapes(request: Request, dialect: Dialect) -> frozenset[Shape]:
    """Return the shape of every response that ``request`` can cause."""
    return ordinary_shapes(request, dialect) | (_ILLEGAL_COMMAND if request.unit else frozenset())


@cache
def _ordinary(command: int, lengths: frozenset[int]) -> frozenset[Shape]:
    acks = {Shape(ACK, length) for length in lengths}
    return frozenset(acks | {Shape(NAK, code) for code in TRAITS[command].refusals})


class ShapedResponse(NamedTuple):
    """A request and the shape of its response."""

    request: Request
    shape: Shape


class PendingResponses(msgspec.Struct, frozen=True):
    """The responses that one unit may still send late or twice. Immutable: each step returns a new one."""

    unit: int
    dialect: Dialect
    outstanding: tuple[Request, ...] = ()
    last: ShapedResponse | None = None
    """The response whose duplicate may arrive during the next exchange."""
    fading: ShapedResponse | None = None
    """The response whose duplicate may arrive during this exchange."""
    was_copy: bool = False
    """Whether the last response may itself have been a duplicate, and so ended nothing."""

    def sent(self, request: Request) -> PendingResponses:
        """Return the state after ``request`` was sent (a broadcast changes nothing: it has no response)."""
        if request.unit != self.unit or request.unit == 0:
            return self
        outstanding = self.outstanding
        if not self._is_a_long_run(len(outstanding) - LONG_RUN) or outstanding[-1] != request:
            outstanding = (*outstanding, request)[-MAX_OUTSTANDING:]
        was_copy = self.was_copy and self.last is not None
        return PendingResponses(self.unit, self.dialect, outstanding, None, self.last, was_copy)

    def received(self, body: bytes) -> PendingResponses:
        """Return the state after a frame of this unit, awaited or not (rule 1). A possible duplicate ends
        nothing; but of two in a row one is no duplicate, because no response comes three times."""
        shape = shape_of(body)
        if shape is None:
            return self
        for position, request in enumerate(self.outstanding):
            if shape in possible_shapes(request, self.dialect):
                may_be_copy = self._may_be_a_copy(shape) and not self.was_copy
                ended = 0 if may_be_copy else position + (not self._is_a_long_run(position))
                response = ShapedResponse(request, shape)
                return PendingResponses(
                    self.unit, self.dialect, self.outstanding[ended:], response, self.fading, may_be_copy
                )
        return self

    @property
    def may_hold_secret(self) -> bool:
        """Whether a late response may carry a value that must not be kept or shown (#21)."""
        last = () if self.last is None else (self.last.request,)
        return any(is_secret(request) for request in (*self.outstanding, *last))

    def moved_on(self) -> PendingResponses:
        """Return the state after a request to another unit; the last response cannot come again."""
        if self.last is None and self.fading is None:
            return self
        return PendingResponses(self.unit, self.dialect, self.outstanding)

    def _is_a_long_run(self, position: int) -> bool:
        """Return whether a run of equal reads begins at ``position`` of which no more are kept."""
        run = self.outstanding[position : position + LONG_RUN] if position >= 0 else ()
        return len(run) == LONG_RUN and not is_write(run[0]) and all(sent == run[0] for sent in run)

    def believes(self, request: Request, body: bytes) -> bool:
        """Return whether ``body``, which fits ``request``, can only be its response (rule 3)."""
        late = self._may_be_late(request)
        twice = self._may_come_twice(request)
        if not late and not twice:
            return True
        shape = shape_of(body)
        return shape not in late | twice and (not late or shape in ordinary_shapes(request, self.dialect))

    def fence_before(self, request: Request) -> Request | None:
        """Return the read to send before ``request``, or None if it may follow at once (rule 4)."""
        return self._first_of_fences(request) if self._may_mislead(request) else None

    def fence(self) -> Request:
        """Return the one of the two fences whose response would leave less outstanding."""
        return min(self._fences(), key=self._left_pending_by)

    def _may_mislead(self, request: Request) -> bool:
        shapes = self._may_be_late(request) | self._may_come_twice(request)
        return bool(shapes & ordinary_shapes(request, self.dialect))

    def _first_of_fences(self, request: Request) -> Request:
        """Return the first of the fewest answered fences after which ``request`` may follow."""
        best_first = sorted(self._fences(), key=self._left_pending_by)
        reached = {self._after(fence): fence for fence in best_first}
        for _ in range(MAX_FENCES_PLANNED):
            for pending, first in reached.items():
                if not pending._may_mislead(request):
                    return first
            reached = {
                pending._after(fence): first for pending, first in reached.items() for fence in self._fences()
            }
        return self.fence()

    def _fences(self) -> tuple[Request, Request]:
        return ReadStatusRequest(self.unit), ReadParameterRequest(self.unit, OWN_ADDRESS)

    def _after(self, fence: Request) -> PendingResponses:
        """Return the state once ``fence`` has got its shortest acknowledgement."""
        data = bytes(min(acknowledged_lengths(fence, self.dialect)))
        return self.sent(fence).received(bytes((self.unit, ACK, *data)))

    def _may_be_late(self, request: Request) -> set[Shape]:
        """Return the shapes of late responses that could be confused with that to ``request``; the same read
        is excepted, unless a write went out after it.
        """
        shapes: set[Shape] = set()
        written_since = False
        for sent in reversed(self.outstanding):
            if written_since or not _reads_the_same(sent, request):
                shapes |= possible_shapes(sent, self.dialect)
            written_since = written_since or is_write(sent)
        return shapes

    def _may_be_a_copy(self, shape: Shape) -> bool:
        return any(response is not None and response.shape == shape for response in (self.last, self.fading))

    def _may_come_twice(self, request: Request) -> set[Shape]:
        """Return the shape of the last response, unless the same read may take it."""
        if self.last is None:
            return set()
        written_since = any(is_write(sent) for sent in self.outstanding)
        harmless = _reads_the_same(self.last.request, request) and not written_since
        return set() if harmless else {self.last.shape}

    def _left_pending_by(self, fence: Request) -> int:
        lengths = acknowledged_lengths(fence, self.dialect)
        responses = (bytes((self.unit, ACK, *bytes(length))) for length in lengths)
        pending = [
            len(self.sent(fence).received(response).outstanding) + (not self.believes(fence, response))
            for response in responses
        ]
        return max(pending)


class PendingByUnit:
    """The late and duplicate responses that the units of one bus may still send."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._units: dict[int, PendingResponses] = {}
        self._last_unit = 0

    def about(self, unit: int) -> PendingResponses:
        """Return the late and duplicate responses of ``unit`` as of a request sent to it now."""
        pending = self._units.get(unit) or PendingResponses(unit, self._dialect)
        return pending if unit == self._last_unit else pending.moved_on()

    def may_hold_secret(self, unit: int) -> bool:
        """Return whether a response of ``unit`` may still bring a value that must not be shown (#21)."""
        pending = self._units.get(unit)
        return pending is not None and pending.may_hold_secret

    def after(self, pending: PendingResponses) -> None:
        """Note that an exchange has ended and left ``pending``."""
        if pending.unit:
            self._units[pending.unit] = pending
            self._last_unit = pending.unit


def _reads_the_same(earlier: Request, later: Request) -> bool:
    return earlier == later and not is_write(later)


class Responded(msgspec.Struct, frozen=True):
    """An event: the response to the request has come."""

    reply: Reply
    frame: ReceivedFrame


class _WithFrame(msgspec.Struct, frozen=True):
    frame: ReceivedFrame


class Foreign(msgspec.Struct, frozen=True):
    """A good frame with an address other than that of the request."""

    unit: int
    frame: ReceivedFrame


class Echo(_WithFrame, frozen=True):
    """An event: the request itself came back."""


class Unexpected(_WithFrame, frozen=True):
    """A good frame of the addressed unit that is no response to this command."""


class Late(_WithFrame, frozen=True):
    """A good frame of the unit that belongs, or may belong, to an earlier request."""


class Duplicate(_WithFrame, frozen=True):
    """An event: the response came a second time."""


ExchangeEvent = Responded | Foreign | Echo | Unexpected | Late | Duplicate | Noise | DoubledChecksum


class Exchange:
    """A request and everything that comes back.

    ``decoder`` is that of the previous exchange if its bytes may still arrive; the default is a new one.
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
        """The time of the first byte after the request (and its echo), by the caller's clock."""
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
        """Return when the response that was complete at ``ended`` began; a byte takes ``byte_s`` seconds. A
        first byte that an adapter held back came earlier than it was read."""
        begins = ended - len(self.frame) * byte_s
        return begins if self.first_byte_at is None else min(begins, self.first_byte_at - byte_s)

    def give_up(self) -> None:
        """Treat whatever comes from now on as late, because the deadline has passed."""
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

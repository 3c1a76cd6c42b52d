"""One exchange at a time over an open port: deadlines, windows, and what else comes in.

The window of an answer (``bus.line.exchange.window``) begins when the request's last byte has left the wire,
which is computed, not waited for.

On a port that is as slow as its baud rate says (``port_pace``), a frame that is complete before the
answer can be is a leftover of an earlier exchange. On such a port nothing can be done before the answer
can be complete, so until shortly before that moment bytes are left to gather. What has gathered by then is
still seen to be early.

While an answer is under way the request that follows can be prepared: it leaves as soon as the answer is
there, and all else that is to be done about that answer is done after.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from bus.contract import Direction
from bus.errors import WireError
from bus.line.clock import LineClock
from bus.line.exchange.current_exchange import CurrentExchange
from bus.line.exchange.port_pace import PortPace
from bus.line.exchange.send_attempts import ExchangeResult
from bus.line.exchange.window import MARGIN_S, QUIET_BYTES, Window
from bus.line.port.port import OpenPort
from bus.line.roster import Roster
from bus.line.statistics.trace import Trace, TracedFrame
from bus.line.statistics.wire_statistics import StrayFrame, WireCounts, WireStatistics
from bus.settings import Dialect, wire_seconds
from bus.wire.commands import Request
from bus.wire.exchange import Answered, Doubled, Exchange, ExchangeEvent, Foreign, Late, Unexpected
from bus.wire.fence import PendingByUnit, PendingResponses
from bus.wire.framing import DoubledChecksum, Fault, FrameDecoder, Noise

LISTEN_FRACTION = 0.93
"""So long a part of the least time bytes are left to gather, as each few that are heard alone cost as much as
an answer; less than ``port_pace.EARLY``."""
SECRET_LINGERS_S = 5.0
"""For so long after an exchange with a secret (#21) whatever is no answer may be a piece of it, or a copy."""
AHEAD_S = 0.002
"""So long before an answer can be complete they are heard in any case: a loop's timers count milliseconds."""


class Link:
    """Sends one request, gives one ``ExchangeResult``. ``done`` may send the next in the same breath."""

    def __init__(
        self, dialect: Dialect, baud: int, turnaround_s: float, clock: LineClock, roster: Roster, trace: Trace
    ) -> None:
        self._dialect = dialect
        self._byte_s = wire_seconds(1, baud)
        self._turnaround_s = turnaround_s
        self._clock = clock
        self._trace = trace
        self._statistics = WireStatistics(roster)
        self._port: OpenPort | None = None
        self._window = Window(clock, self._nothing_came)
        self._current: CurrentExchange | None = None
        self._idle: Exchange | None = None
        self._next: Exchange | None = None
        """What leaves as soon as the answer to ``_current`` is there."""
        self._pace = PortPace()
        self._overdue: list[int] = []
        self._secret_until = -math.inf
        self._forget()
        self.done: Callable[[ExchangeResult, float, float], None] = _ignore
        """Called with what was heard and when the exchange began and ended."""

    # --- the port ------------------------------------------------------------------------------

    def attach(self, port: OpenPort, baud: int) -> None:
        """The port is open: nothing that was under way before can still arrive."""
        self._port = port
        self._idle = None
        self._go_at(baud)
        self._pace = PortPace()

    def retune(self, baud: int) -> None:
        """Go on at ``baud``. Raises WireError where the port cannot."""
        if self._port is not None:
            self._port.retune(baud)
        self._go_at(baud)

    def detach(self) -> ExchangeResult | None:
        """The port is gone; gives the exchange under way, which has no answer."""
        current, self._current, self._next = self._current, None, None
        self._port = None
        self._window.attach(None, self._byte_s)
        if current is None:
            return None
        return ExchangeResult(current.exchange.request, None, self._clock.epoch(current.ends_sending))

    @property
    def open(self) -> bool:
        """Whether there is a port."""
        return self._port is not None

    @property
    def busy(self) -> bool:
        """Whether an exchange is under way."""
        return self._current is not None

    @property
    def paced(self) -> bool:
        """Whether the port is known to be as slow as its baud rate."""
        return self._pace.paced is True

    @property
    def counts(self) -> WireCounts:
        """What the bus carried since the worker started."""
        return self._statistics.wire

    def pending(self, unit: int) -> PendingResponses:
        """What ``unit`` may still answer late or twice.

        However slow the port: this process may have been kept from running, and what came meanwhile
        looks as if it came just now. So the order of frames is trusted, their moment is not.
        """
        return self._pending.about(unit)

    def _go_at(self, baud: int) -> None:
        self._byte_s = wire_seconds(1, baud)
        self._window.attach(self._port, self._byte_s)
        self._forget()

    def _forget(self) -> None:
        """Nothing of what was said before matters any more."""
        self._decoder = FrameDecoder(self._dialect)
        self._pending = PendingByUnit(self._dialect)
        self._next = None

    # --- one exchange --------------------------------------------------------------------------

    def send(self, request: Request, dialect: Dialect | None = None) -> None:
        """Begin an exchange, ``dialect`` where it is not the bus's own.

        Raises CallerError for a request that no frame can carry, WireError when the port does not take it.
        """
        assert self._port is not None
        assert self._current is None
        exchange = self._exchange(request, self.pending(request.unit), dialect)
        began = self._clock.now()
        self._port.write(exchange.sent)
        self._begin(exchange, began)

    def prepare(self, request: Request) -> None:
        """Have ``request`` leave as soon as the answer under way, another unit's, is there.

        It does not where anything is strange about that answer, and never on a port faster than its rate:
        then ``done`` finds the link free. Raises CallerError for a request that no frame can carry.
        """
        assert self._current is not None
        assert request.unit != self._current.exchange.request.unit
        self._next = self._exchange(request, self.pending(request.unit).moved_on(), None)

    def do_not_follow(self) -> None:
        """Something else is more urgent than what was prepared."""
        self._next = None

    def data_received(self, data: bytes) -> None:
        """Bytes came in."""
        now = self._clock.now()
        current = self._current
        exchange = current.exchange if current is not None else self._idle
        if exchange is None:
            self._statistics.wire.noise_bytes += len(data)
            self._note_stray(now, data, None, valid=False)
            return
        events = exchange.receive(data, now)
        followed_at = self._follow(current, events, now) if current is not None and self._next else None
        self._window.received(now, inside_frame=self._decoder.pending > 0)
        for event in events:
            self._take(event, exchange, now)
        if current is not None and current.exchange.reply is not None:
            self._finish(current, now, followed_at)

    def _exchange(self, request: Request, pending: PendingResponses, dialect: Dialect | None) -> Exchange:
        return Exchange(request, dialect or self._dialect, decoder=self._decoder, pending=pending)

    def _follow(self, current: CurrentExchange, events: list[ExchangeEvent], now: float) -> float | None:
        """Send what was prepared, if ``events`` are the answer and nothing else; when it was sent."""
        if len(events) != 1 or not isinstance(events[0], Answered):
            return None
        least_s = (len(current.exchange.sent) + len(events[0].frame.wire)) * self._byte_s
        if not self._pace.on_time(now - current.began, least_s):
            return None
        assert self._next is not None
        assert self._port is not None
        began = self._clock.now()
        try:
            self._port.write(self._next.sent)
        except WireError:
            # The port is lost, and tells so at the next request.
            return None
        return began

    def _begin(self, exchange: Exchange, began: float) -> None:
        """``exchange`` was handed to the port at ``began``."""
        asks = exchange.request.unit != 0
        ends_sending = began + len(exchange.sent) * self._byte_s
        window_ends = ends_sending + (self._turnaround_s + MARGIN_S if asks else 0.0)
        longest_s = exchange.prepared.longest_reply_bytes * self._byte_s
        last_moment = window_ends + (longest_s + MARGIN_S if asks else 0.0)
        self._current = CurrentExchange(exchange, began, ends_sending, last_moment)
        self._window.open(window_ends, last_moment, self._listen_at(exchange, began, window_ends))
        self._note(began, "out", exchange.sent, exchange)

    def _finish(self, current: CurrentExchange, now: float, followed_at: float | None = None) -> None:
        self._current, self._idle = None, current.exchange
        following, self._next = self._next, None
        self._window.close()
        self._pending.after(current.exchange.pending)
        if following is not None and followed_at is not None:
            self._begin(following, followed_at)
        current.overdue, self._overdue = tuple(self._overdue), []
        self.done(current.result(self._clock, now), current.began, now)
        self._statistics.ended(current, now, self._byte_s)

    # --- what came in --------------------------------------------------------------------------

    def _take(self, event: ExchangeEvent, exchange: Exchange, now: float) -> None:
        if isinstance(event, Noise | DoubledChecksum):
            if isinstance(event, Noise):
                self._take_noise(event, exchange.request.unit, now)
            self._note_stray(now, event.data, exchange, valid=False)
            return
        if isinstance(event, Answered):
            self._take_response(event.frame.wire, now)
        else:
            self._take_stray_frame(event, exchange.request.unit)
        if self._current is not None and isinstance(event, Unexpected | Foreign):
            self._current.unexpected = True
        if self._current is not None and isinstance(event, Doubled | Late):
            self._current.late += 1
        if isinstance(event, Answered):
            self._note(now, "in", event.frame.wire, exchange)
        else:
            self._note_stray(now, event.frame.wire, exchange, unit=event.frame.body[0])

    def _take_stray_frame(self, event: StrayFrame, addressed: int) -> None:
        """Another unit's frame is overdue where that unit has not responded to an earlier request. It ends no
        uncertainty about that unit: it may be of a third one that responds to a wrong address."""
        is_overdue = isinstance(event, Foreign) and bool(self.pending(event.unit).outstanding)
        if is_overdue:
            self._overdue.append(event.frame.body[0])
        self._statistics.stray_frame(event, addressed, is_overdue=is_overdue)

    def _take_noise(self, noise: Noise, unit: int, now: float) -> None:
        """After an answer with a wrong checksum no other will come, so only quiet is waited for."""
        self._statistics.noise(noise, unit)
        if self._current is None:
            return
        self._current.garbled = True
        if noise.reason is Fault.CHECKSUM and noise.body[0] == unit:
            self._window.shorten(now + QUIET_BYTES * self._byte_s)

    def _take_response(self, wire: bytes, now: float) -> None:
        current = self._current
        if current is None:
            return
        least_s = (len(current.exchange.sent) + len(wire)) * self._byte_s
        if self._pace.believes(now - current.began, least_s):
            current.frame = wire
            return
        request = current.exchange.request
        self._statistics.late_or_duplicate(request.unit)
        current.late += 1
        current.exchange = self._exchange(request, self.pending(request.unit), current.exchange.dialect)

    # --- waiting -------------------------------------------------------------------------------

    def _listen_at(self, exchange: Exchange, began: float, window_ends: float) -> float | None:
        """Shortly before the answer can be complete, on a port that is as slow as its baud rate."""
        if not self.paced or exchange.request.unit == 0:
            return None
        least_s = (len(exchange.sent) + exchange.prepared.least_reply_bytes) * self._byte_s
        unheard_s = min(LISTEN_FRACTION * least_s, least_s - AHEAD_S)
        return min(began + unheard_s, window_ends - MARGIN_S / 2)

    def _nothing_came(self, now: float) -> None:
        current = self._current
        if current is None:
            return
        # Of a broadcast nothing ever comes: it may be on its way still, and the next request follows it.
        if current.exchange.awaiting and self._port is not None:
            self._port.drop_output()
        current.exchange.give_up()
        self._finish(current, now)

    def _note(self, now: float, way: Direction, data: bytes, exchange: Exchange) -> None:
        """Keep what is known to belong to ``exchange``."""
        hidden = exchange.prepared.secret
        if hidden:
            self._secret_until = now + SECRET_LINGERS_S
        self._trace.add(TracedFrame(self._clock.epoch(now), way, data, hidden=hidden))

    def _note_stray(
        self, now: float, data: bytes, exchange: Exchange | None, *, unit: int = 0, valid: bool = True
    ) -> None:
        """Keep what is no answer, but not its bytes while it may be a late answer with a secret (#21)."""
        secret = exchange is not None and exchange.prepared.secret
        hidden = secret or now < self._secret_until or self._pending.may_hold_secret(unit)
        self._trace.add(TracedFrame(self._clock.epoch(now), "in", data, valid, hidden))


def _ignore(_result: ExchangeResult, _began: float, _ended: float) -> None:
    """Until the poller listens."""

"""One exchange at a time over an open port: its deadlines, and everything else that comes in.

The window of a response (``bus.line.timing``) begins when the request's last byte has left the wire, a moment
that is computed, not waited for.

On a port that is as slow as its baud rate (``PortPace``), a frame that is complete before the response can be
is a leftover of an earlier exchange. On such a port bytes are left to gather until shortly before the
response can be complete, because nothing could be done with them before. Whatever has gathered by then is
still recognized as early.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine, Generator
from typing import Any, Generic, TypeVar

import msgspec

from bus.contract import Direction
from bus.errors import WireError
from bus.instants import Monotonic
from bus.line.diagnosis import SecondMaster
from bus.line.port import OpenPort, PartlySent
from bus.line.roster import Roster, WireCounts
from bus.line.send import NO_NOISE, ExchangeResult, LineNoise
from bus.line.timing import MARGIN_S, QUIET_BYTES, LineClock, PortPace, Window
from bus.line.trace import Trace, TracedFrame
from bus.messages import Message
from bus.settings import Dialect, wire_seconds
from bus.wire.commands import Request, least_reply_bytes, longest_reply_bytes
from bus.wire.exchange import (
    Duplicate,
    Echo,
    Exchange,
    ExchangeEvent,
    Foreign,
    Late,
    PendingByUnit,
    PendingResponses,
    Responded,
    Unexpected,
)
from bus.wire.framing import DoubledChecksum, Fault, FrameDecoder, Noise

T = TypeVar("T")


class Completion(Generic[T]):
    """A result that is set once and awaited by one coroutine, which ``run_at_once`` runs.

    The waiter continues in the same turn of the event loop in which the result is set. A task continues one
    turn later, which is 0.026 ms of an idle wire for each poll, 0.001 of the rate. So ``set`` runs the
    coroutine up to its next wait, on the stack of its caller, which does nothing of the line's after it. The
    coroutine is never resumed while it runs: what is set meanwhile is there when it is awaited.
    """

    __slots__ = ("is_set", "result", "resume")

    def __init__(self) -> None:
        self.is_set = False
        self.result: T
        self.resume: Callable[[], None] | None = None

    def set(self, result: T) -> None:
        """Set the result and run the coroutine that awaits it."""
        self.result, self.is_set = result, True
        if self.resume is not None:
            self.resume()

    def __await__(self) -> Generator[Completion[T], None, T]:
        if not self.is_set:
            yield self
        return self.result


async def run_at_once(coroutine: Coroutine[Completion[Any], None, T]) -> T:
    """Run ``coroutine``, which awaits nothing but completions, until it ends; cancellation closes it."""
    ended: asyncio.Future[T] = asyncio.get_running_loop().create_future()

    def step() -> None:
        if ended.done():
            return
        try:
            coroutine.send(None).resume = step
        except StopIteration as end:
            ended.set_result(end.value)
        except Exception as error:
            ended.set_exception(error)

    step()
    try:
        return await ended
    finally:
        coroutine.close()


class CurrentExchange(msgspec.Struct):
    """The exchange under way. Times are the line's own, in seconds."""

    exchange: Exchange
    began: Monotonic
    ends_sending: Monotonic
    """The time when the request's last byte has left."""
    last_moment: Monotonic
    """The moment after which no response can come, even if this process receives it later."""
    ended: Monotonic = Monotonic(0.0)
    is_ordinary: bool = False
    """Whether the response came alone, at a time at which it is expected."""
    garbled: bool = False
    unexpected: bool = False
    unrequested: bool = False
    """Whether a unit responded to something that this host has not requested."""
    late: int = 0
    overdue: tuple[int, ...] = ()

    @property
    def has_noise(self) -> bool:
        """Whether anything came in beside the response."""
        return self.garbled or self.unexpected or self.late > 0

    def result(self, clock: LineClock) -> ExchangeResult:
        """Return the result of the exchange."""
        exchange = self.exchange
        responded_at = clock.epoch(min(self.ended, self.last_moment)) if exchange.reply is not None else None
        # Bytes that never became a frame are noise too: two units at one address may sound like that.
        garbled = self.garbled or (exchange.reply is None and exchange.first_byte_at is not None)
        return ExchangeResult(
            exchange.request,
            exchange.reply,
            self.began,
            self.ended,
            clock.epoch(self.ends_sending),
            responded_at,
            b"" if exchange.secret else exchange.frame,
            LineNoise(garbled, self.unexpected, self.late) if garbled or self.has_noise else NO_NOISE,
            exchange.dialect,
            self.overdue,
        )


StrayFrame = Echo | Foreign | Duplicate | Late | Unexpected

LISTEN_FRACTION = 0.93
"""The part of the least time during which bytes gather, because receiving a few alone costs as much as a
response; it is less than ``EARLY`` in ``bus.line.timing``."""
SECRET_LINGERS_S = 5.0
"""The seconds after an exchange with a secret (#21) in which other bytes may be a part or copy of it."""
AHEAD_S = 0.002
"""The seconds before a response can be complete when bytes are taken: timers count milliseconds."""


class Link:
    """The link of one bus: ``prepare`` an exchange, ``send`` it, await its end and ``account`` for it."""

    def __init__(
        self,
        dialect: Dialect,
        baud: int,
        turnaround_s: float,
        clock: LineClock,
        roster: Roster,
        trace: Trace,
    ) -> None:
        self._dialect = dialect
        self._byte_s = wire_seconds(1, baud)
        self._turnaround_s = turnaround_s
        self._clock = clock
        self._trace = trace
        self._roster = roster
        self.counts = WireCounts()
        self.second_master = SecondMaster()
        self._port: OpenPort | None = None
        self._window = Window(clock, self._timed_out)
        self._current: CurrentExchange | None = None
        self._ending: Completion[CurrentExchange] = Completion()
        self._last: Exchange | None = None
        """The previous exchange, in whose context bytes are read that come in while none is under way."""
        self._last_response = b""
        self._unaccounted: CurrentExchange | None = None
        self._pace = PortPace()
        self._secret_until = Monotonic(-math.inf)
        self.loss: Message | None = None
        """The reason why the last port was lost."""
        self.has_responses = False
        """Whether any unit has responded since the port was opened."""
        self._forget()

    # --- the port ------------------------------------------------------------------------------

    def attach(self, port: OpenPort, baud: int) -> None:
        """Use a newly opened port; nothing that was under way before can still arrive."""
        self._port = port
        self._last = None
        self.loss, self.has_responses = None, False
        self._go_at(baud)
        self._pace = PortPace()

    def retune(self, baud: int) -> None:
        """Continue at ``baud``. Raise WireError if the port cannot."""
        if self._port is not None:
            self._port.retune(baud)
        self._go_at(baud)

    def lose(self, cause: Message) -> None:
        """Give up the port; the exchange under way ends without a response."""
        if self._port is None:
            return
        self._port, self.loss = None, cause
        self._window.attach(None, self._byte_s)
        current, self._current = self._current, None
        if current is not None:
            current.ended = self._clock.now()
            self._ending.set(current)

    @property
    def open(self) -> bool:
        return self._port is not None

    @property
    def is_paced(self) -> bool:
        """Whether the port is known to be as slow as its baud rate."""
        return self._pace.paced is True

    def pending(self, unit: int) -> PendingResponses:
        """Return the responses of ``unit`` that may still come late or twice.

        This holds for fast ports too: the process may have been kept from running, and bytes that came
        meanwhile look as if they came just now. Therefore the order of frames is trusted, their time is not.
        """
        return self._pending.about(unit)

    def _go_at(self, baud: int) -> None:
        self._byte_s = wire_seconds(1, baud)
        self._window.attach(self._port, self._byte_s)
        self._forget()

    def _forget(self) -> None:
        """Forget all bytes that came in before."""
        self._overdue: list[int] = []
        self._decoder = FrameDecoder(self._dialect)
        self._pending = PendingByUnit(self._dialect)

    # --- one exchange --------------------------------------------------------------------------

    def prepare(self, request: Request, dialect: Dialect | None = None) -> Exchange:
        """Return an exchange to ``send``, in ``dialect`` if given, else in the dialect of the bus.

        An exchange under way must be with another unit; the new one then follows it. Raise CallerError for a
        request that no frame can carry.
        """
        pending = self.pending(request.unit)
        if self._current is not None:
            assert self._current.exchange.request.unit != request.unit
            pending = pending.moved_on()
        return self._exchange(request, dialect, pending)

    def send(self, exchange: Exchange) -> Completion[CurrentExchange] | None:
        """Begin ``exchange`` and return a completion of its end, or None if nothing was sent because the port
        is lost. A port that is lost later, or that took only a part, ends the exchange without a response."""
        assert self._current is None
        if self._port is None:
            return None
        began, loss = self._clock.now(), None
        try:
            self._port.write(exchange.sent)
        except PartlySent as error:
            loss = error.message
        except WireError as error:
            self.lose(error.message)
            return None
        self.account()
        self._begin(exchange, began)
        ending = self._ending = Completion()
        if loss is not None:
            self.lose(loss)
        return ending

    def account(self) -> None:
        """Count the exchange that has ended and put it into the trace, once. This is called after the next
        request has left, so that the request does not wait for it."""
        if self._unaccounted is None:
            return
        ended, self._unaccounted = self._unaccounted, None
        self._window.close()
        if ended.is_ordinary:
            self._pace.believes(ended.ended - ended.began, self._least_s(ended.exchange))
            self._note(ended.ended, "in", ended.exchange.frame, ended.exchange)
        ended.overdue, self._overdue = tuple(self._overdue), []
        self.has_responses = self.has_responses or ended.exchange.reply is not None
        self._pending.after(ended.exchange.pending)
        self._count(ended)

    def _count(self, ended: CurrentExchange) -> None:
        exchange = ended.exchange
        if exchange.reply is not None:
            self.second_master.responded(exchange.request.unit)
            if ended.unrequested:
                self.second_master.note(ended.ended)
        self.counts.busy_s += self._least_s(exchange)
        if exchange.reply is not None:
            self._last_response = exchange.frame
        if exchange.request.unit != 0:
            response_s = exchange.response_began(ended.ended, self._byte_s) - ended.ends_sending
            self._roster[exchange.request.unit].statistics.count(exchange.request, exchange.reply, response_s)

    def data_received(self, data: bytes) -> None:
        now = self._clock.now()
        current = self._current
        exchange = current.exchange if current is not None else self._last
        if exchange is None:
            self.counts.noise_bytes += len(data)
            self._note_stray(now, data, None, valid=False)
            return
        events = exchange.receive(data, now)
        if current is not None and self._is_ordinary(current, events, now):
            self._end(current, now)
            return
        self._window.received(now, inside_frame=self._decoder.pending > 0)
        for event in events:
            self._take(event, exchange, now)
        if current is not None and current.exchange.reply is not None:
            self._end(current, now)

    def _is_ordinary(self, current: CurrentExchange, events: list[ExchangeEvent], now: Monotonic) -> bool:
        """Return whether ``events`` are only the response, at a time at which it is expected."""
        if len(events) != 1 or type(events[0]) is not Responded or current.has_noise or self._overdue:
            return False
        current.is_ordinary = self._pace.on_time(now - current.began, self._least_s(current.exchange))
        return current.is_ordinary

    def _least_s(self, exchange: Exchange) -> float:
        """Return the least seconds that the request and its response take on the wire."""
        return (len(exchange.sent) + len(exchange.frame)) * self._byte_s

    def _exchange(self, request: Request, dialect: Dialect | None, pending: PendingResponses) -> Exchange:
        return Exchange(request, dialect or self._dialect, decoder=self._decoder, pending=pending)

    def _begin(self, exchange: Exchange, began: Monotonic) -> None:
        """Begin to await the response to ``exchange``, which was handed to the port at ``began``."""
        has_response = exchange.request.unit != 0
        ends_sending = began + len(exchange.sent) * self._byte_s
        window_ends = ends_sending + (self._turnaround_s + MARGIN_S if has_response else 0.0)
        longest_s = longest_reply_bytes(exchange.request, exchange.dialect) * self._byte_s
        last_moment = window_ends + (longest_s + MARGIN_S if has_response else 0.0)
        self._current = CurrentExchange(exchange, began, ends_sending, last_moment)
        self.second_master.requested(exchange.request.unit, began)
        self._window.open(window_ends, last_moment, self._listen_at(exchange, began, window_ends))
        self._note(began, "out", exchange.sent, exchange)

    def _end(self, current: CurrentExchange, now: Monotonic) -> None:
        """End the exchange under way, as the caller's last step, because the next exchange begins in it."""
        self._current, self._last, self._unaccounted = None, current.exchange, current
        current.ended = now
        self._ending.set(current)

    # --- what came in --------------------------------------------------------------------------

    def _take(self, event: ExchangeEvent, exchange: Exchange, now: Monotonic) -> None:
        if isinstance(event, Noise | DoubledChecksum):
            if isinstance(event, Noise):
                self._take_noise(event, exchange.request.unit, now)
            self._note_stray(now, event.data, exchange, valid=False)
        elif isinstance(event, Responded):
            self._take_response(now)
            self._note(now, "in", event.frame.wire, exchange)
        else:
            self._take_stray_frame(event, exchange.request.unit, now)
            self._note_stray(now, event.frame.wire, exchange, unit=event.frame.body[0])

    def _take_stray_frame(self, event: StrayFrame, addressed: int, now: Monotonic) -> None:
        """Count a valid frame that is not the response of unit ``addressed``."""
        match event:
            case Echo():
                self.counts.echoes += 1
            case Duplicate() | Late():
                self._count_late(addressed)
                self.second_master.explains(addressed, now)
                if self._current is not None:
                    self._current.late += 1
            case Foreign() if self._is_another_s_late(event):
                self._count_late(event.unit)
                self.second_master.explains(event.unit, now)
            case Unexpected() | Foreign() if addressed:
                self._roster[addressed].statistics.counts.foreign += 1
                if isinstance(event, Foreign):
                    self._judge_sender(event, now)
        if self._current is not None and isinstance(event, Unexpected | Foreign):
            self._current.unexpected = True

    def _judge_sender(self, event: Foreign, now: Monotonic) -> None:
        """Note a response that no request of this host explains, at once or as the exchange under way
        ends."""
        if self.second_master.explains(event.unit, now):
            return
        if self._current is not None:
            self._current.unrequested = True
        else:
            self.second_master.note(now)

    def _is_another_s_late(self, event: Foreign) -> bool:
        """Return whether a frame of another unit is late: that unit owes a response to an earlier request, or
        this frame equals the last response. The unit still owes its response: a third unit with a wrong
        address may have sent the frame."""
        is_overdue = bool(self.pending(event.unit).outstanding)
        if is_overdue:
            self._overdue.append(event.unit)
        return is_overdue or event.frame.wire == self._last_response

    def _count_late(self, unit: int) -> None:
        self._roster[unit].statistics.counts.late += 1

    def _take_noise(self, noise: Noise, unit: int, now: Monotonic) -> None:
        """Count noise. No other response follows one with a wrong checksum, so then only quiet is awaited."""
        self.counts.noise_bytes += len(noise.data)
        if noise.reason is Fault.CHECKSUM:
            self._roster[unit].statistics.counts.checksum_errors += 1
        if self._current is None:
            return
        self._current.garbled = True
        if noise.reason is Fault.CHECKSUM and noise.body[0] == unit:
            self._window.shorten(now + QUIET_BYTES * self._byte_s)

    def _take_response(self, now: Monotonic) -> None:
        """Count a response that came too early to be that of the request as late, and await another."""
        current = self._current
        if current is None or self._pace.believes(now - current.began, self._least_s(current.exchange)):
            return
        request = current.exchange.request
        self._count_late(request.unit)
        current.late += 1
        current.exchange = self._exchange(request, current.exchange.dialect, self.pending(request.unit))

    # --- waiting -------------------------------------------------------------------------------

    def _listen_at(self, exchange: Exchange, began: Monotonic, window_ends: Monotonic) -> Monotonic | None:
        """Return the moment shortly before the response can be complete, or None on a port faster than its
        baud rate."""
        if not self.is_paced or exchange.request.unit == 0:
            return None
        least_bytes = len(exchange.sent) + least_reply_bytes(exchange.request, exchange.dialect)
        least_s = least_bytes * self._byte_s
        gathering_s = min(LISTEN_FRACTION * least_s, least_s - AHEAD_S)
        return min(began + gathering_s, window_ends - MARGIN_S / 2)

    def _timed_out(self, now: Monotonic) -> None:
        current = self._current
        if current is None:
            return
        # A broadcast has no response: it may still be on its way, and the next request follows it.
        if current.exchange.awaiting and self._port is not None:
            self._port.drop_output()
        current.exchange.give_up()
        self._end(current, now)

    def _note(self, now: Monotonic, way: Direction, data: bytes, exchange: Exchange) -> None:
        """Put a frame into the trace that is known to belong to ``exchange``."""
        hidden = exchange.secret
        if hidden:
            self._secret_until = now + SECRET_LINGERS_S
        self._trace.add(TracedFrame(self._clock.epoch(now), way, data, hidden=hidden))

    def _note_stray(
        self, now: Monotonic, data: bytes, exchange: Exchange | None, *, unit: int = 0, valid: bool = True
    ) -> None:
        """Put other bytes into the trace, hidden while they may be a late response with a secret (#21)."""
        secret = exchange is not None and exchange.secret
        hidden = secret or now < self._secret_until or self._pending.may_hold_secret(unit)
        self._trace.add(TracedFrame(self._clock.epoch(now), "in", data, valid, hidden))

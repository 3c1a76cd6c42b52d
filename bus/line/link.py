"""One exchange at a time over an open port: deadlines, windows, and what else comes in.

The window of an answer (``bus.line.window``) begins when the request's last byte has left the wire,
which is computed, not waited for.

On a port that is as slow as its baud rate says, a frame that is complete before the answer can be is a
leftover of an earlier exchange. A port may be faster (an unpaced simulator, a device server that
buffers): that shows at its first answer, and then this test is left out.

On such a slow port nothing can be done before the answer can be complete, so until shortly before that
moment bytes are left to gather. What has gathered by then is still seen to be early.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bus.contract import Direction
from bus.line.asking import Heard
from bus.line.clock import Clock
from bus.line.port import OpenPort
from bus.line.roster import Roster
from bus.line.steps import NO_RUBBISH, Rubbish
from bus.line.trace import Passed, Trace
from bus.line.window import QUIET_BYTES, Window
from bus.settings import BITS_PER_BYTE, Dialect
from bus.wire.commands import Nak, ReadStatus, Request
from bus.wire.exchange import Answered, Doubled, Echo, Event, Exchange, Foreign, Late, Unexpected
from bus.wire.fence import Doubt, Doubts
from bus.wire.framing import DoubledChecksum, Fault, FrameDecoder, Noise, ReceivedFrame

MARGIN_S = 0.010
"""What the machine and the adapter may add to a unit's turnaround."""
EARLY = 0.9
"""A frame that is there in less than this part of the least time cannot be the answer."""
UNHEARD = 0.85
"""So long a part of the least time bytes are left to gather; less than ``EARLY``."""
EARLY_TO_BELIEVE = 3
ON_TIME_TO_BELIEVE = 50


@dataclass(slots=True)
class WireCounts:
    """What the whole bus carried since the worker started."""

    busy_s: float = 0.0
    noise_bytes: int = 0
    echoes: int = 0
    broadcasts: int = 0


class Pace:
    """Whether the port is as slow as its baud rate: learned from its answers."""

    def __init__(self) -> None:
        self.paced: bool | None = None
        self._against = 0

    def believes(self, *, early: bool) -> bool:
        """Whether an answer may be taken; ``early``: it was complete before it could be."""
        if self.paced is None:
            self.paced = not early
        if early != self.paced:
            self._against = 0
            return True
        self._against += 1
        if self._against >= (EARLY_TO_BELIEVE if self.paced else ON_TIME_TO_BELIEVE):
            self.paced, self._against = not self.paced, 0
            return True
        return not early


@dataclass(slots=True)
class _Current:
    """The exchange under way, in the line's own time."""

    exchange: Exchange
    began: float
    ends_sending: float
    """When the request's last byte has left."""
    last_moment: float
    """No answer can come later, whenever this process gets to hear it."""
    dialect: Dialect
    frame: bytes = b""
    spoilt: bool = False
    strange: bool = False


class Link:
    """Sends one request, gives one ``Heard``. ``done`` may send the next in the same breath."""

    def __init__(
        self, dialect: Dialect, baud: int, turnaround_s: float, clock: Clock, roster: Roster, trace: Trace
    ) -> None:
        self._dialect = dialect
        self._byte_s = BITS_PER_BYTE / baud
        self._turnaround_s = turnaround_s
        self._clock = clock
        self._roster = roster
        self._trace = trace
        self._port: OpenPort | None = None
        self._pace = Pace()
        self._decoder = FrameDecoder(dialect)
        self._doubts = Doubts(dialect)
        self._current: _Current | None = None
        self._idle: Exchange | None = None
        self._window = Window(clock, self._nothing_came)
        self._last_answer = b""
        self.done: Callable[[Heard, float, float], None] = _nobody
        """Called with what was heard and when the exchange began and ended."""
        self.counts = WireCounts()

    # --- the port ------------------------------------------------------------------------------

    def attach(self, port: OpenPort, baud: int) -> None:
        """The port is open: nothing that was under way before can still arrive."""
        self._port = port
        self._byte_s = BITS_PER_BYTE / baud
        self._window.attach(port, self._byte_s)
        self._pace = Pace()
        self._decoder = FrameDecoder(self._dialect)
        self._doubts = Doubts(self._dialect)
        self._idle = None

    def retune(self, baud: int) -> None:
        """Go on at ``baud``. Raises WireError where the port cannot."""
        if self._port is not None:
            self._port.retune(baud)
        self._byte_s = BITS_PER_BYTE / baud
        self._window.attach(self._port, self._byte_s)
        self._decoder = FrameDecoder(self._dialect)
        self._doubts = Doubts(self._dialect)

    def detach(self) -> Heard | None:
        """The port is gone; gives the exchange under way, which has no answer."""
        current, self._current = self._current, None
        self._port = None
        self._window.attach(None, self._byte_s)
        if current is None:
            return None
        return Heard(current.exchange.request, None, self._clock.epoch(current.ends_sending))

    @property
    def open(self) -> bool:
        """Whether there is a port."""
        return self._port is not None

    @property
    def busy(self) -> bool:
        """Whether an exchange is under way."""
        return self._current is not None

    def doubt(self, unit: int) -> Doubt:
        """What ``unit`` may still answer late or twice.

        However slow the port: this process may have been kept from running, and what came meanwhile
        looks as if it came just now. So the order of frames is trusted, their moment is not.
        """
        return self._doubts.about(unit)

    def least_s(self, sent_bytes: int, received_bytes: int) -> float:
        """What an exchange takes on the wire."""
        return (sent_bytes + received_bytes) * self._byte_s

    # --- one exchange --------------------------------------------------------------------------

    def send(self, request: Request, dialect: Dialect | None = None) -> None:
        """Begin an exchange, ``dialect`` where it is not the bus's own.

        Raises CallerError for a request that no frame can carry, WireError when the port does not take it.
        """
        assert self._port is not None
        assert self._current is None
        doubt = self.doubt(request.unit)
        dialect = dialect or self._dialect
        exchange = Exchange(request, dialect, decoder=self._decoder, doubt=doubt)
        began = self._clock.now()
        self._port.write(exchange.sent)
        ends_sending = began + len(exchange.sent) * self._byte_s
        longest = exchange.prepared.longest_reply_bytes * self._byte_s
        window_s = self._turnaround_s + MARGIN_S if request.unit else 0.0
        last_moment = ends_sending + window_s + (longest + MARGIN_S if request.unit else 0.0)
        self._current = _Current(exchange, began, ends_sending, last_moment, dialect)
        window_ends = ends_sending + window_s
        self._window.open(window_ends, last_moment, self._unheard_until(exchange, began, window_ends))
        self._note(began, "out", exchange.sent, exchange)

    def data_received(self, data: bytes) -> None:
        """Bytes came in."""
        now = self._clock.now()
        self._window.heard(now)
        current = self._current
        exchange = current.exchange if current is not None else self._idle
        if exchange is None:
            self.counts.noise_bytes += len(data)
            self._note(now, "in", data, None, valid=False)
            return
        for event in exchange.receive(data, now):
            self._take(event, exchange, now)
        if current is not None and current.exchange.reply is not None:
            self._finish(current, now)

    def _take(self, event: Event, exchange: Exchange, now: float) -> None:
        request = exchange.request
        if isinstance(event, Noise | DoubledChecksum):
            if isinstance(event, Noise):
                self._take_noise(event, request, now)
            self._note(now, "in", event.data, exchange, valid=False)
            return
        statistics = self._roster[request.unit].statistics
        match event:
            case Answered(frame=frame):
                self._take_answer(frame.wire, now)
            case Echo():
                self.counts.echoes += 1
            case Foreign(unit=unit, frame=frame):
                self._foreign(unit, frame, request)
            case Doubled():
                self._heard_twice(request.unit)
            case Late():
                statistics.late += 1
            case Unexpected():
                statistics.foreign += 1
        if self._current is not None and isinstance(event, Unexpected | Foreign):
            self._current.strange = True
        self._note(now, "in", event.frame.wire, exchange)

    def _take_noise(self, noise: Noise, request: Request, now: float) -> None:
        self.counts.noise_bytes += len(noise.data)
        if self._current is not None:
            self._current.spoilt = True
        if noise.reason is not Fault.CHECKSUM:
            return
        self._roster[request.unit].statistics.checksum_errors += 1
        if self._current is not None and noise.body[0] == request.unit:
            self._spoilt(now)

    def _take_answer(self, wire: bytes, now: float) -> None:
        current = self._current
        if current is None:
            return
        least = (len(current.exchange.sent) + len(wire)) * self._byte_s
        if self._pace.believes(early=now - current.began < least * EARLY):
            current.frame = self._last_answer = wire
            return
        request = current.exchange.request
        self._heard_twice(request.unit)
        doubt = self.doubt(request.unit)
        current.exchange = Exchange(request, current.dialect, decoder=self._decoder, doubt=doubt)

    def _heard_twice(self, unit: int) -> None:
        self._roster[unit].statistics.late += 1

    def _foreign(self, unit: int, frame: ReceivedFrame, request: Request) -> None:
        """Another unit's frame: late where that unit owes one or says its last once more, else a mistake.

        It ends no doubt about that unit, for it may be of a third one that answers to a wrong address.
        """
        if self._doubts.about(unit).outstanding or frame.wire == self._last_answer:
            self._heard_twice(unit)
        elif request.unit:
            self._roster[request.unit].statistics.foreign += 1

    def _spoilt(self, now: float) -> None:
        """The answer came with a wrong checksum: no other will come, so only quiet is waited for."""
        self._window.shorten(now + QUIET_BYTES * self._byte_s)

    def _finish(self, current: _Current, now: float) -> None:
        exchange = current.exchange
        request = exchange.request
        self._current, self._idle = None, exchange
        self._window.close()
        self._doubts.after(exchange.doubt)
        heard = Heard(
            request,
            exchange.reply,
            self._clock.epoch(current.ends_sending),
            self._clock.epoch(min(now, current.last_moment)) if exchange.reply is not None else None,
            b"" if exchange.prepared.secret else current.frame,
            _rubbish(current),
        )
        self.done(heard, current.began, now)
        self._count(current, now)

    def _count(self, current: _Current, ended: float) -> None:
        exchange = current.exchange
        request = exchange.request
        self.counts.busy_s += (len(exchange.sent) + len(current.frame)) * self._byte_s
        if request.unit == 0:
            self.counts.broadcasts += 1
            return
        statistics = self._roster[request.unit].statistics
        statistics.polls += isinstance(request, ReadStatus)
        if exchange.reply is None:
            statistics.timeouts += 1
            return
        statistics.answers += 1
        begins = ended - len(current.frame) * self._byte_s
        if exchange.first_byte_at is not None:
            begins = min(begins, exchange.first_byte_at - self._byte_s)
        statistics.times.add(begins - current.ends_sending)
        if isinstance(exchange.reply, Nak):
            statistics.refused(exchange.reply.code)

    # --- waiting -------------------------------------------------------------------------------

    def _unheard_until(self, exchange: Exchange, began: float, window_ends: float) -> float | None:
        """Shortly before the answer can be complete, on a port that is as slow as its baud rate."""
        if not self._pace.paced or exchange.request.unit == 0:
            return None
        least_s = self.least_s(len(exchange.sent), exchange.prepared.least_reply_bytes)
        return min(began + UNHEARD * least_s, window_ends - MARGIN_S / 2)

    def _nothing_came(self, now: float) -> None:
        current = self._current
        if current is None:
            return
        # Of a broadcast nothing ever comes: it may be on its way still, and the next request follows it.
        if current.exchange.awaiting and self._port is not None:
            self._port.drop_output()
        current.exchange.give_up()
        self._finish(current, now)

    def _note(
        self, now: float, way: Direction, data: bytes, exchange: Exchange | None, *, valid: bool = True
    ) -> None:
        hidden = exchange is not None and exchange.prepared.secret
        self._trace.add(Passed(self._clock.epoch(now), way, data, valid, hidden))


def _nobody(_heard: Heard, _began: float, _ended: float) -> None:
    """Until the poller listens."""


def _rubbish(current: _Current) -> Rubbish:
    """Bytes that never became a frame are rubbish too: two units at one address may sound like that."""
    exchange = current.exchange
    spoilt = current.spoilt or (exchange.reply is None and exchange.first_byte_at is not None)
    return Rubbish(spoilt, current.strange) if spoilt or current.strange else NO_RUBBISH

"""The scan of a port without other users: opens it at one baud rate and requests address after address.

The window of a response is that of a bus at work, but after the response it stays open until the line is
quiet, to receive a second copy or a checksum byte that is sent twice. A unit that is slower than the
turnaround it is allowed responds into the window of another request, where its response passes for noise or,
worse, for the response to that request. A unit that seems to do so is sent one request with a long window; if
it is slow, everything collected until then is invalid.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from bus.errors import WireError
from bus.instants import Monotonic
from bus.line.examination import Checksum10h, Examination, Found, Passes, Probe, ProbeOutcome
from bus.line.opener import OpenPort, open_port
from bus.line.send import LineNoise
from bus.line.timing import MARGIN_S, LineClock, RealClock, Window
from bus.messages import Message
from bus.settings import Dialect, wire_seconds
from bus.wire.commands import ReadStatusRequest, longest_reply_bytes
from bus.wire.exchange import (
    Duplicate,
    Echo,
    Exchange,
    ExchangeEvent,
    Foreign,
    Late,
    PendingByUnit,
    Responded,
    Unexpected,
)
from bus.wire.framing import DLE, DoubledChecksum, FrameDecoder, Noise, ReceivedFrame

_PLAIN = Dialect()


@asynccontextmanager
async def scan_port(port: str, baud: int) -> AsyncIterator[ScanPort]:
    """Open ``port`` for a scan. Raise WireError if it cannot be opened."""
    line = ScanPort(baud, RealClock())
    opened = await open_port(port, baud, line)
    line.attach(opened)
    try:
        yield line
    finally:
        opened.close()
        # The transport gives the device back in the loop's next turn; until then this process has it.
        await asyncio.sleep(0)


@dataclass(slots=True)
class Collected:
    """An exchange and everything that arrived in its window. Times are seconds of the line's clock."""

    exchange: Exchange
    ends_sending: Monotonic
    """The time when the request's last byte has left."""
    byte_s: float
    events: list[ExchangeEvent] = field(default_factory=list)
    response_ends: Monotonic | None = None
    """The time when the response was complete."""

    @property
    def turnaround_s(self) -> float | None:
        """Seconds from the request's last byte to the response's first, at most; None without a response."""
        if self.response_ends is None:
            return None
        begins = self.exchange.response_began(self.response_ends, self.byte_s)
        return max(0.0, begins - self.ends_sending)


class ScanPort:
    """An open port of a scan, or the one that ``attach`` is given, and the ``Receiver`` of its bytes."""

    def __init__(self, baud: int, clock: LineClock) -> None:
        self.echoes = False
        self._clock = clock
        self._byte_s = wire_seconds(1, baud)
        self._window = Window(clock, self._on_window_over)
        self._decoder = FrameDecoder(_PLAIN)
        self._pending = PendingByUnit(_PLAIN)
        self._port: OpenPort | None = None
        self._current: Collected | None = None
        self._over: asyncio.Future[None] | None = None
        self._unrequested_bytes = 0
        self._lost: Message | None = None

    def attach(self, port: OpenPort) -> None:
        self._port = port
        self._window.attach(port, self._byte_s)

    async def listen(self, seconds: float) -> int:
        """Return the number of bytes that arrive in ``seconds`` without a request. Raise WireError if the
        port is lost."""
        self._unrequested_bytes = 0
        await asyncio.sleep(seconds)
        self._check()
        return self._unrequested_bytes

    async def exchange(self, probe: Probe, turnaround_s: float) -> Collected:
        """Send one request; a unit may respond within ``turnaround_s``. Raise WireError on a lost port."""
        self._check()
        assert self._port is not None
        request = probe.request
        exchange = Exchange(
            request,
            probe.dialect,
            decoder=self._decoder,
            pending=self._pending.about(request.unit),
        )
        began = self._clock.now()
        self._port.write(exchange.sent)
        collected = Collected(exchange, began + len(exchange.sent) * self._byte_s, self._byte_s)
        await self._until_quiet(collected, turnaround_s)
        exchange.give_up()
        self._pending.after(exchange.pending)
        self.echoes = self.echoes or any(isinstance(event, Echo) for event in collected.events)
        return collected

    async def _until_quiet(self, collected: Collected, turnaround_s: float) -> None:
        ends = collected.ends_sending + turnaround_s + MARGIN_S + self._byte_s
        longest_s = longest_reply_bytes(collected.exchange.request, _PLAIN) * self._byte_s
        self._current, self._over = collected, asyncio.get_running_loop().create_future()
        self._window.open(ends, ends + 2 * longest_s)
        try:
            await self._over
        finally:
            self._window.close()
            self._current = None
        self._check()
        rest = self._decoder.flush()
        collected.events += [each for each in rest if not isinstance(each, ReceivedFrame)]

    def _on_window_over(self, _now: Monotonic) -> None:
        if self._over is not None and not self._over.done():
            self._over.set_result(None)

    def _check(self) -> None:
        if self._lost:
            raise WireError(self._lost)

    # --- bus.line.port.Receiver ----------------------------------------------------------------

    def data_received(self, data: bytes) -> None:
        now, current = self._clock.now(), self._current
        if current is None:
            self._unrequested_bytes += len(data)
            return
        current.events += current.exchange.receive(data, now)
        self._window.received(now, inside_frame=self._decoder.pending > 0)
        if current.exchange.reply is None:
            return
        if current.response_ends is None:
            current.response_ends = now
        self._window.shorten(now)

    def connection_lost(self, cause: Message) -> None:
        self._lost = cause
        self._on_window_over(self._clock.now())


PATIENCE_S = 1.0
"""The longest time in seconds that a unit takes to respond; the manual names no such time."""
ALLOWANCE = 2.0
"""The multiple of its response time that a slow unit is allowed from then on: all devices vary."""


class SlowUnitError(Exception):
    """Raised for a unit that is at least as slow as allowed; ``allowance_s``: the seconds to allow."""

    def __init__(self, turnaround_s: float) -> None:
        super().__init__(turnaround_s)
        self.allowance_s = min(ALLOWANCE * turnaround_s, PATIENCE_S)


class Prober:
    """The examination of addresses over ``line``. ``turnaround_s``: how long a unit may take to begin its
    response."""

    def __init__(self, line: ScanPort, baud: int, turnaround_s: float) -> None:
        self._line = line
        self._baud = baud
        self._turnaround_s = turnaround_s
        self._without_response: dict[int, Monotonic] = {}
        """The times of requests to units that have not responded since."""
        self._quick: set[int] = set()

    async def examine(self, unit: int) -> Found | None:
        """Return everything about one address, or None if nothing responds. Raise SlowUnitError or
        WireError."""
        examination = Examination(unit, self._baud).run()
        try:
            probe = next(examination)
            while True:
                probe = examination.send(await self._probe(probe))
        except StopIteration as end:
            found: Found | None = end.value
            return found

    async def _probe(self, probe: Probe) -> ProbeOutcome:
        collected = await self._line.exchange(probe, self._turnaround_s)
        for unit in self._seem_late(collected):
            await self._measure(unit)
        unit = probe.request.unit
        if collected.exchange.reply is None:
            self._without_response[unit] = collected.ends_sending
        else:
            self._without_response.pop(unit, None)
        return _outcome(collected)

    def _seem_late(self, collected: Collected) -> set[int]:
        """Return the units whose response to an earlier request may be among what was collected."""
        responded = {event.unit for event in collected.events if isinstance(event, Foreign)}
        if any(isinstance(event, Responded | Late) for event in collected.events):
            responded.add(collected.exchange.request.unit)
        sent_at = collected.ends_sending
        recent = {unit for unit, at in self._without_response.items() if sent_at - at < PATIENCE_S}
        return responded & recent - self._quick

    async def _measure(self, unit: int) -> None:
        """Send a request with a long window. Raise SlowUnitError for a unit that needs more time."""
        if self._turnaround_s >= PATIENCE_S:
            return
        await self._line.listen(PATIENCE_S)
        collected = await self._line.exchange(Probe(ReadStatusRequest(unit)), PATIENCE_S)
        took_s = collected.turnaround_s
        if took_s is not None and ALLOWANCE * took_s > self._turnaround_s:
            raise SlowUnitError(took_s)
        self._quick.add(unit)


def _outcome(collected: Collected) -> ProbeOutcome:
    events = collected.events
    noise = LineNoise(
        garbled=any(isinstance(event, Noise) for event in events),
        unexpected=any(isinstance(event, Foreign | Unexpected) for event in events),
        late=sum(isinstance(event, Duplicate | Late) for event in events),
    )
    checksum_10h: Checksum10h | None = None
    if any(isinstance(event, DoubledChecksum) for event in events):
        checksum_10h = "twice"
    elif collected.exchange.frame.endswith(bytes((DLE,))):
        checksum_10h = "once"
    return ProbeOutcome(collected.exchange.reply, noise, checksum_10h, collected.turnaround_s)


LISTEN_S = 0.2
"""The seconds of listening to the line before the first request."""
MAX_UNREQUESTED_BYTES = 10
"""The most bytes in that time with which responses can be distinguished from other traffic."""


@dataclass(slots=True)
class BaudScan:
    """The results so far at one baud rate. ``echoes``: the adapter receives what it sends. ``turnaround_s``:
    the time within which a unit begins its response; it grows if a unit is slower."""

    baud: int
    turnaround_s: float
    found: list[Found] = field(default_factory=list)
    echoes: bool = False
    seconds: float = 0.0


async def scan_baud(
    scan: BaudScan, port: str, addresses: Sequence[int], progress: Callable[[int], None]
) -> None:
    """Request each of ``addresses`` and record in ``scan`` which respond, in their order.

    ``progress`` is called with how many of ``PASSES`` requests for each address are done; with a negative
    number when all are repeated, because a unit is slower than was allowed. Raise WireError if the port
    cannot be opened or is lost, or if unrequested bytes arrive.
    """
    async with scan_port(port, scan.baud) as line:
        await scan_addresses(scan, line, addresses, progress)


async def scan_addresses(
    scan: BaudScan, line: ScanPort, addresses: Sequence[int], progress: Callable[[int], None]
) -> None:
    """Scan ``addresses`` over an open port."""
    began = asyncio.get_running_loop().time()
    if (unrequested := await line.listen(LISTEN_S)) > MAX_UNREQUESTED_BYTES:
        raise WireError(Message.of("bytes_unrequested", count=unrequested, seconds=LISTEN_S))
    while True:
        passes, prober = Passes(addresses), Prober(line, scan.baud, scan.turnaround_s)
        try:
            for unit in passes:
                settled, one = passes.settled, await prober.examine(unit)
                passes.note(found=one is not None)
                if one is not None:
                    scan.found.append(one)
                    scan.found.sort(key=lambda each: each.unit)
                scan.echoes, scan.seconds = line.echoes, asyncio.get_running_loop().time() - began
                progress(passes.settled - settled)
            return
        except SlowUnitError as slow:
            scan.turnaround_s = slow.allowance_s
            scan.found.clear()
            progress(-passes.settled)

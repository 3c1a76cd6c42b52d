"""A port that a scan has to itself: one request at a time, and everything that arrives meanwhile.

The window of a response is that of a bus at work (``bus.line.exchange.window``), but after the response it
stays open until the line is quiet, to receive a second copy or a checksum byte that is sent twice.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from bus.errors import WireError
from bus.instants import Monotonic
from bus.line.clock import LineClock, RealClock
from bus.line.exchange.window import MARGIN_S, Window
from bus.line.port.open_port import OpenPort, open_port
from bus.line.scan.examination import Probe
from bus.messages import Message
from bus.settings import Dialect, wire_seconds
from bus.wire.exchange import Echo, Exchange, ExchangeEvent
from bus.wire.fence import PendingByUnit
from bus.wire.framing import FrameDecoder, ReceivedFrame
from bus.wire.lengths import longest_reply_bytes

_PLAIN = Dialect()


@asynccontextmanager
async def scan_port(port: str, baud: int) -> AsyncIterator[ScanPort]:
    """``port``, open for a scan. Raises WireError when it cannot be opened."""
    line = ScanPort(baud, RealClock())
    opened = await open_port(port, baud, line)
    line.attach(opened)
    try:
        yield line
    finally:
        opened.close()
        # The transport gives the device back in the loop's next turn; until then it is in use by us.
        await asyncio.sleep(0)


@dataclass(slots=True)
class Collected:
    """One exchange and all that arrived in its window. Times in seconds of the line's clock."""

    exchange: Exchange
    ends_sending: Monotonic
    """When the request's last byte has left."""
    byte_s: float
    events: list[ExchangeEvent] = field(default_factory=list)
    response_ends: Monotonic | None = None
    """When the response was complete."""

    @property
    def turnaround_s(self) -> float | None:
        """Seconds from the request's last byte to the response's first, at most; None without a response."""
        if self.response_ends is None:
            return None
        begins = self.exchange.response_began(self.response_ends, self.byte_s)
        return max(0.0, begins - self.ends_sending)


class ScanPort:
    """An open port, or the one that ``attach`` is given: receives its bytes (``Receiver``)."""

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
        self._window.attach(self._byte_s)

    async def listen(self, seconds: float) -> int:
        """How many bytes arrive although nothing is requested. Raises WireError when the port is lost."""
        self._unrequested_bytes = 0
        await asyncio.sleep(seconds)
        self._check()
        return self._unrequested_bytes

    async def exchange(self, probe: Probe, turnaround_s: float) -> Collected:
        """Send one request; a unit may begin within ``turnaround_s``. Raises WireError on a lost port."""
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

    # --- bus.line.port.port.Receiver ----------------------------------------------------------------

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

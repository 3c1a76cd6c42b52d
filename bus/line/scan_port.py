"""A port that a scan has for itself: one question at a time, and everything that comes meanwhile.

One window ends when a unit's turnaround is over and nothing is coming in any more; after an answer it
stays open for a few byte times, to hear a second copy or a checksum byte that is sent twice.

A unit that is slower than the turnaround it is allowed answers into the window of another question, where
its answer passes for rubbish or, worse, for that question's. Whoever seems to do so is asked once with
patience; where it is so, nothing that was heard until then is worth anything.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from bus.errors import WireError
from bus.line.examination import Outcome, Question, examine
from bus.line.found import Checksum10h, Found
from bus.line.passes import MARGIN_S
from bus.line.transport import OpenPort, open_port
from bus.settings import BITS_PER_BYTE, Dialect
from bus.wire.commands import ReadStatus
from bus.wire.exchange import Answered, Doubled, Echo, Event, Exchange, Foreign, Late, Unexpected
from bus.wire.fence import Doubts
from bus.wire.framing import DLE, DoubledChecksum, FrameDecoder, Noise, ReceivedFrame
from bus.wire.lengths import longest_reply_bytes

QUIET_BYTES = 4
LEAST_QUIET_S = 0.005
PATIENCE_S = 1.0
"""No unit takes longer to answer; the manual names no such time."""

_PLAIN = Dialect()
_DOUBLED = Dialect(checksum_10h="twice")


class SlowUnitError(Exception):
    """A unit takes longer to begin its answer than it was allowed: ``seconds``."""

    def __init__(self, seconds: float) -> None:
        super().__init__(f"a unit takes {1000 * seconds:.0f} ms to begin its answer")
        self.seconds = seconds


@asynccontextmanager
async def scan_port(port: str, baud: int) -> AsyncIterator[ScanPort]:
    """``port``, open for a scan. Raises WireError when it cannot be opened."""
    ear = _Ear()
    opened = await open_port(port, baud, ear)
    try:
        yield ScanPort(opened, ear, baud)
    finally:
        opened.close()
        # The transport gives the device back in the loop's next turn; until then it is in use by us.
        await asyncio.sleep(0)


class _Ear:
    """Holds what comes in until somebody listens."""

    def __init__(self) -> None:
        self._came = asyncio.Event()
        self._data = bytearray()
        self._lost = ""

    def data_received(self, data: bytes) -> None:
        self._data += data
        self._came.set()

    def connection_lost(self, cause: str) -> None:
        self._lost = cause
        self._came.set()

    async def hear(self, seconds: float) -> bytes:
        """What came within ``seconds``, as soon as something did. Raises WireError when the port is lost."""
        try:
            async with asyncio.timeout(max(seconds, 0.0)):
                await self._came.wait()
        except TimeoutError:
            return b""
        if self._lost:
            raise WireError(self._lost)
        data = bytes(self._data)
        self._data.clear()
        self._came.clear()
        return data


class ScanPort:
    """An open port and what is known of it. ``turnaround_s``: what a unit may take to begin its answer."""

    def __init__(self, port: OpenPort, ear: _Ear, baud: int) -> None:
        self.echoes = False
        self.turnaround_s = PATIENCE_S
        self._port = port
        self._ear = ear
        self._baud = baud
        self._byte_s = BITS_PER_BYTE / baud
        self._quiet_s = max(QUIET_BYTES * self._byte_s, LEAST_QUIET_S)
        self._decoder = FrameDecoder(_PLAIN)
        self._doubts = Doubts(_PLAIN)
        self._unanswered: dict[int, float] = {}
        """When units were asked that have not answered since."""
        self._known_as_quick: set[int] = set()

    async def listen(self, seconds: float) -> int:
        """How many bytes come although nobody asks."""
        loop = asyncio.get_running_loop()
        until, count = loop.time() + seconds, 0
        while loop.time() < until:
            count += len(await self._ear.hear(until - loop.time()))
        return count

    async def examine(self, unit: int) -> Found | None:
        """Everything about one address. Raises SlowUnitError, WireError."""
        examination = examine(unit, self._baud)
        try:
            question = next(examination)
            while True:
                question = examination.send(await self._ask(question))
        except StopIteration as end:
            found: Found | None = end.value
            return found

    async def _ask(self, question: Question) -> Outcome:
        exchange, events, ends_sending = await self._exchange(question)
        for unit in self._seem_late(exchange, events, ends_sending):
            self._known_as_quick.add(unit)
            await self._ask_with_patience(unit)
        if exchange.reply is None:
            self._unanswered[question.request.unit] = ends_sending
        else:
            self._unanswered.pop(question.request.unit, None)
        return _outcome(exchange, events, self._answered_after_s(exchange, ends_sending))

    def _seem_late(self, exchange: Exchange, events: list[Event], now: float) -> set[int]:
        """Units whose answer to an earlier question this may have been."""
        heard = {event.frame.body[0] for event in events if isinstance(event, Foreign)}
        if exchange.reply is not None:
            heard.add(exchange.request.unit)
        recent = {unit for unit, at in self._unanswered.items() if now - at < PATIENCE_S}
        return heard & recent - self._known_as_quick

    async def _ask_with_patience(self, unit: int) -> None:
        allowed_s = self.turnaround_s
        if allowed_s >= PATIENCE_S:
            return
        await self.listen(PATIENCE_S)
        self.turnaround_s = PATIENCE_S
        exchange, _, ends_sending = await self._exchange(Question(ReadStatus(unit)))
        self.turnaround_s = allowed_s
        took_s = self._answered_after_s(exchange, ends_sending)
        if took_s is not None and took_s > allowed_s:
            self._unanswered.clear()
            self._known_as_quick.clear()
            raise SlowUnitError(took_s)

    def _answered_after_s(self, exchange: Exchange, ends_sending: float) -> float | None:
        if exchange.reply is None or exchange.first_byte_at is None:
            return None
        return max(0.0, exchange.first_byte_at - self._byte_s - ends_sending)

    async def _exchange(self, question: Question) -> tuple[Exchange, list[Event], float]:
        """Ask and hear; also when the request's last byte had left."""
        request = question.request
        exchange = Exchange(
            request,
            _DOUBLED if question.doubled else _PLAIN,
            decoder=self._decoder,
            doubt=self._doubts.about(request.unit),
        )
        self._port.write(exchange.sent)
        ends_sending = asyncio.get_running_loop().time() + len(exchange.sent) * self._byte_s
        events = await self._window(exchange, ends_sending)
        exchange.give_up()
        self._doubts.after(exchange.doubt)
        self.echoes = self.echoes or any(isinstance(event, Echo) for event in events)
        return exchange, events, ends_sending

    async def _window(self, exchange: Exchange, ends_sending: float) -> list[Event]:
        loop = asyncio.get_running_loop()
        closes = ends_sending + self.turnaround_s + MARGIN_S + self._byte_s
        at_most = closes + 2 * longest_reply_bytes(exchange.request, _PLAIN) * self._byte_s
        events: list[Event] = []
        while (now := loop.time()) < closes:
            data = await self._ear.hear(closes - now)
            now = loop.time()
            if data:
                events += exchange.receive(data, now)
                quiet_at = now + self._quiet_s
                closes = min(at_most, quiet_at if exchange.reply is not None else max(closes, quiet_at))
        return events + [rest for rest in self._decoder.flush() if not isinstance(rest, ReceivedFrame)]


def _outcome(exchange: Exchange, events: list[Event], answered_after_s: float | None) -> Outcome:
    def any_is(*kinds: type) -> bool:
        return any(isinstance(event, kinds) for event in events)

    return Outcome(
        reply=exchange.reply,
        spoilt=any_is(Noise),
        strange=any_is(Foreign, Unexpected),
        twice=any_is(Doubled, Late),
        checksum_10h=_checksum_10h(events),
        answered_after_s=answered_after_s,
    )


def _checksum_10h(events: list[Event]) -> Checksum10h | None:
    if any(isinstance(event, DoubledChecksum) for event in events):
        return "twice"
    answers = [event.frame.wire for event in events if isinstance(event, Answered)]
    return "once" if any(wire[-1] == DLE for wire in answers) else None

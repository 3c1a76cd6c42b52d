"""The scan of a port that nobody else uses: opens it at one baud rate and asks address after address.

One window ends when a unit's turnaround is over and nothing is coming in any more; after an answer it
stays open for a few byte times, to hear a second copy or a checksum byte that is sent twice.

An answer may get lost, so nobody is called absent after one question: the silent addresses are asked once
more when all have been asked, and again as long as that finds somebody.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from bus.errors import WireError
from bus.line.scan import MARGIN_S, Checksum10h, Found, Outcome, Question, examine
from bus.line.transport import OpenPort, open_port
from bus.settings import BITS_PER_BYTE, Dialect
from bus.wire.commands import longest_reply_bytes
from bus.wire.exchange import Answered, Doubled, Echo, Event, Exchange, Foreign, Late, Unexpected
from bus.wire.fence import Doubts
from bus.wire.framing import DLE, DoubledChecksum, FrameDecoder, Noise, ReceivedFrame

QUIET_BYTES = 4
LEAST_QUIET_S = 0.005
LISTEN_S = 0.2
"""How long the line is listened to before anything is asked."""
MOST_UNASKED_BYTES = 10
"""More than this in that time, and nothing on the line can be told from anything else."""

PASSES = 2
MOST_PASSES = 4

_PLAIN = Dialect()
_DOUBLED = Dialect(checksum_10h="twice")


@dataclass(slots=True)
class BaudScan:
    """What has answered so far at one baud rate. ``echoes``: the adapter hears what it sends."""

    baud: int
    found: list[Found] = field(default_factory=list)
    echoes: bool = False
    seconds: float = 0.0


async def scan_baud(
    scan: BaudScan,
    port: str,
    addresses: Iterable[int],
    turnaround_s: float,
    progress: Callable[[int], None],
) -> None:
    """Ask every one of ``addresses`` and put down in ``scan`` who answers, in their order.

    ``progress`` is called with how many of ``PASSES`` questions for each address are settled.
    Raises WireError when the port cannot be opened or is lost, or when bytes come that nobody asked for.
    """
    began = asyncio.get_running_loop().time()
    async with _opened(port, scan.baud, turnaround_s) as line:
        if (unasked := await line.listen(LISTEN_S)) > MOST_UNASKED_BYTES:
            raise WireError(
                f"{unasked} bytes came in {LISTEN_S} s although nobody asked: is another host on this line, "
                "or is the cable open? Silence it and scan again"
            )
        silent, passes, found_again = list(addresses), 0, False
        while silent and (passes < PASSES or (found_again and passes < MOST_PASSES)):
            asked, silent = silent, []
            for unit in asked:
                one = await line.examine(unit)
                if one is None:
                    silent.append(unit)
                else:
                    scan.found.append(one)
                    scan.found.sort(key=lambda each: each.unit)
                scan.echoes, scan.seconds = line.echoes, asyncio.get_running_loop().time() - began
                progress(1 if one is None else max(PASSES - passes, 0))
            passes, found_again = passes + 1, len(silent) < len(asked)


@asynccontextmanager
async def _opened(port: str, baud: int, turnaround_s: float) -> AsyncIterator[_Line]:
    ear = _Ear()
    opened = await open_port(port, baud, ear)
    try:
        yield _Line(opened, ear, baud, turnaround_s)
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


class _Line:
    """An open port and what is known of it."""

    def __init__(self, port: OpenPort, ear: _Ear, baud: int, turnaround_s: float) -> None:
        self.echoes = False
        self._port = port
        self._ear = ear
        self._baud = baud
        self._byte_s = BITS_PER_BYTE / baud
        self._turnaround_s = turnaround_s
        self._quiet_s = max(QUIET_BYTES * self._byte_s, LEAST_QUIET_S)
        self._decoder = FrameDecoder(_PLAIN)
        self._doubts = Doubts(_PLAIN)

    async def listen(self, seconds: float) -> int:
        """How many bytes come although nobody asks."""
        loop = asyncio.get_running_loop()
        until, count = loop.time() + seconds, 0
        while loop.time() < until:
            count += len(await self._ear.hear(until - loop.time()))
        return count

    async def examine(self, unit: int) -> Found | None:
        """Everything about one address."""
        examination = examine(unit, self._baud)
        try:
            question = next(examination)
            while True:
                question = examination.send(await self._ask(question))
        except StopIteration as end:
            found: Found | None = end.value
            return found

    async def _ask(self, question: Question) -> Outcome:
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
        first_byte_at = exchange.first_byte_at if exchange.reply is not None else None
        after_s = None if first_byte_at is None else max(0.0, first_byte_at - self._byte_s - ends_sending)
        return _outcome(exchange, events, after_s)

    async def _window(self, exchange: Exchange, ends_sending: float) -> list[Event]:
        loop = asyncio.get_running_loop()
        closes = ends_sending + self._turnaround_s + MARGIN_S + self._byte_s
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

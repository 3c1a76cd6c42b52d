"""The scan of a port without other users: opens it at one baud rate and requests address after address.

A unit that is slower than the turnaround it is allowed responds into the window of another request, where its
response passes for noise or, worse, for that request's. A unit that seems to is sent one request with a long
window; if it is slow, nothing that was collected until then is valid.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from bus.errors import WireError
from bus.instants import Monotonic
from bus.line.exchange.send import LineNoise
from bus.line.scan.examination import Examination, Probe, ProbeOutcome
from bus.line.scan.found import Checksum10h, Found
from bus.line.scan.passes import Passes
from bus.line.scan.scan_port import Collected, ScanPort, scan_port
from bus.messages import Message
from bus.wire.commands import ReadStatusRequest
from bus.wire.exchange import Duplicate, Foreign, Late, Responded, Unexpected
from bus.wire.framing import DLE, DoubledChecksum, Noise

PATIENCE_S = 1.0
"""No unit takes longer to respond; the manual names no such time."""
ALLOWANCE = 2.0
"""What a slow unit is allowed from then on, as a multiple of what it took: units vary, and so do adapters."""


class SlowUnitError(Exception):
    """A unit takes as long as it is allowed, or longer; ``allowance_s`` is what to allow instead."""

    def __init__(self, turnaround_s: float) -> None:
        super().__init__(turnaround_s)
        self.allowance_s = min(ALLOWANCE * turnaround_s, PATIENCE_S)


class Prober:
    """Examines addresses over ``line``. ``turnaround_s``: what a unit may take to begin its response."""

    def __init__(self, line: ScanPort, baud: int, turnaround_s: float) -> None:
        self._line = line
        self._baud = baud
        self._turnaround_s = turnaround_s
        self._without_response: dict[int, Monotonic] = {}
        """When requests were sent to units that have not responded since."""
        self._quick: set[int] = set()

    async def examine(self, unit: int) -> Found | None:
        """Everything about one address, None where nothing responds. Raises SlowUnitError, WireError."""
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
        """Units whose response to an earlier request this may have been."""
        responded = {event.unit for event in collected.events if isinstance(event, Foreign)}
        if any(isinstance(event, Responded | Late) for event in collected.events):
            responded.add(collected.exchange.request.unit)
        sent_at = collected.ends_sending
        recent = {unit for unit, at in self._without_response.items() if sent_at - at < PATIENCE_S}
        return responded & recent - self._quick

    async def _measure(self, unit: int) -> None:
        """Send a request with a long window. Raises SlowUnitError for a unit that needs more time."""
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
"""How long the line is received before the first request."""
MAX_UNREQUESTED_BYTES = 10
"""More than this in that time, and responses cannot be distinguished from other traffic."""


@dataclass(slots=True)
class BaudScan:
    """What has responded so far at one baud rate. ``echoes``: the adapter receives what it sends.

    ``turnaround_s``: within which a unit begins its response; it grows where a unit is slower.
    """

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
    number when all are repeated, because a unit is slower than was allowed. Raises WireError when the port
    cannot be opened or is lost, or when unrequested bytes arrive.
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

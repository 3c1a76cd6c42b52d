"""Sends the requests of an examination over a port of a scan, and detects units slower than it allows.

A unit that is slower than the turnaround it is allowed responds into the window of another request, where its
response passes for noise or, worse, for that request's. A unit that seems to is sent one request with a long
window; if it is slow, nothing that was collected until then is valid.
"""

from __future__ import annotations

from bus.instants import Monotonic
from bus.line.scan.examination import Probe, ProbeOutcome, examine
from bus.line.scan.found import Checksum10h, Found
from bus.line.scan.scan_port import Collected, ScanPort
from bus.wire.commands import ReadStatusRequest
from bus.wire.exchange import Duplicate, ExchangeEvent, Foreign, Late, Responded, Unexpected
from bus.wire.framing import DLE, DoubledChecksum, Noise

PATIENCE_S = 1.0
"""No unit takes longer to respond; the manual names no such time."""
ALLOWANCE = 2.0
"""What a slow unit is allowed from then on, as a multiple of what it took: units vary, and so do adapters."""


class SlowUnitError(Exception):
    """A unit takes about as long to begin its response as it is allowed, or longer.

    ``allowance_s``: what units are to be allowed instead.
    """

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
        examination = examine(unit, self._baud)
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
        """Send a request with a long window. Raises SlowUnitError for a unit that needs more than it is
        allowed.
        """
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
    return ProbeOutcome(
        reply=collected.exchange.reply,
        garbled=any(isinstance(event, Noise) for event in events),
        unexpected=any(isinstance(event, Foreign | Unexpected) for event in events),
        surplus=sum(isinstance(event, Duplicate | Late) for event in events),
        checksum_10h=_checksum_10h(events),
        responded_after_s=collected.turnaround_s,
    )


def _checksum_10h(events: list[ExchangeEvent]) -> Checksum10h | None:
    if any(isinstance(event, DoubledChecksum) for event in events):
        return "twice"
    responses = [event.frame.wire for event in events if isinstance(event, Responded)]
    return "once" if any(wire[-1] == DLE for wire in responses) else None

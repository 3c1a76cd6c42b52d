"""What became of every byte and every exchange, counted for the bus and for each unit."""

from __future__ import annotations

from dataclasses import dataclass

from bus.instants import Monotonic
from bus.line.exchange.current_exchange import CurrentExchange
from bus.line.roster import Roster
from bus.wire.commands import Nak, ReadStatusRequest
from bus.wire.exchange import Duplicate, Echo, Foreign, Late, Unexpected
from bus.wire.framing import Fault, Noise

StrayFrame = Echo | Foreign | Duplicate | Late | Unexpected


@dataclass(slots=True)
class WireCounts:
    """What the bus carried since the worker started."""

    busy_s: float = 0.0
    noise_bytes: int = 0
    echoes: int = 0


class WireStatistics:
    """Counts into ``wire`` and into the statistics of the roster's units."""

    def __init__(self, roster: Roster) -> None:
        self.wire = WireCounts()
        self._roster = roster
        self._last_response = b""

    def noise(self, noise: Noise, addressed: int) -> None:
        """Bytes that are no frame, during an exchange with ``addressed``."""
        self.wire.noise_bytes += len(noise.data)
        if noise.reason is Fault.CHECKSUM:
            self._roster[addressed].statistics.counts.checksum_errors += 1

    def stray_frame(self, event: StrayFrame, addressed: int, *, is_overdue: bool) -> None:
        """A good frame that is not the response of ``addressed``."""
        match event:
            case Echo():
                self.wire.echoes += 1
            case Foreign():
                self._foreign(event, addressed, is_overdue=is_overdue)
            case Duplicate() | Late():
                self.late_or_duplicate(addressed)
            case Unexpected():
                self._roster[addressed].statistics.counts.foreign += 1

    def late_or_duplicate(self, unit: int) -> None:
        """Count a response of an earlier exchange, or a duplicate of the last one."""
        self._roster[unit].statistics.counts.late += 1

    def ended(self, exchange: CurrentExchange, byte_s: float) -> None:
        """Count an exchange, with or without a response; a byte takes ``byte_s``."""
        request, reply = exchange.exchange.request, exchange.exchange.reply
        self.wire.busy_s += (len(exchange.exchange.sent) + len(exchange.frame)) * byte_s
        if request.unit == 0:
            return
        statistics = self._roster[request.unit].statistics
        statistics.counts.polls += isinstance(request, ReadStatusRequest)
        if reply is None:
            statistics.counts.timeouts += 1
            return
        self._last_response = exchange.frame
        statistics.counts.responses += 1
        statistics.times.add(_begins(exchange, byte_s) - exchange.ends_sending)
        if isinstance(reply, Nak):
            statistics.refused(reply.code)

    def _foreign(self, event: Foreign, addressed: int, *, is_overdue: bool) -> None:
        """Another unit's frame: late where it is overdue or repeats the last response, else a mistake."""
        if is_overdue or event.frame.wire == self._last_response:
            self.late_or_duplicate(event.unit)
        elif addressed:
            self._roster[addressed].statistics.counts.foreign += 1


def _begins(exchange: CurrentExchange, byte_s: float) -> Monotonic:
    """Return when the response began: a first byte that was left to gather came earlier than it was read."""
    begins = exchange.ended - len(exchange.frame) * byte_s
    first = exchange.exchange.first_byte_at
    return begins if first is None else min(begins, first - byte_s)

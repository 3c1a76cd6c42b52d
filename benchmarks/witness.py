"""A host as the simulated line sees it: how much it polls, and how long it leaves the wire idle."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from benchmarks.tables import median, quantile
from bus.simulator.line import WireEvent, WireEventKind

SHORTEST_POLL_RESPONSE = 10
"""Bytes; the response to a parameter read or a write has fewer."""


@dataclass(frozen=True)
class Seen:
    """``rate``: completed polls a second; ``octets``: bytes of all completed exchanges a second; ``gaps``:
    from a response's last byte to the next request's first.
    """

    rate: float
    octets: float
    per_unit: dict[int, float]
    gaps: list[float]

    @property
    def gap_median(self) -> float:
        return median(self.gaps)

    @property
    def gap_p99(self) -> float:
        return quantile(self.gaps, 0.99)


def look(entries: Iterable[WireEvent], seconds: float) -> Seen:
    """Evaluate the host over a part of the record that lasted ``seconds``."""
    responses: dict[int, int] = {}
    gaps: list[float] = []
    responded_at: float | None = None
    requested = octets = 0
    for entry in entries:
        if entry.what is WireEventKind.SENT:
            responded_at = entry.at
            octets += requested + len(entry.data)
            requested = 0
        elif entry.what is WireEventKind.RESPONDED and len(entry.data) >= SHORTEST_POLL_RESPONSE:
            responses[entry.unit] = responses.get(entry.unit, 0) + 1
        elif entry.what is WireEventKind.CAME:
            requested = len(entry.data)
            if responded_at is not None:
                gaps.append(entry.at - responded_at)
                responded_at = None
    per_unit = {unit: count / seconds for unit, count in sorted(responses.items())}
    return Seen(sum(per_unit.values()), octets / seconds, per_unit, gaps)

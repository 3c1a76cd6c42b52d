"""What the simulated line saw of a host: how much it asked, and how long it kept the wire idle."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from benchmarks.tables import median, quantile
from bus.simulator.record import Happened, WireEvent

SHORTEST_POLL_ANSWER = 10
"""Bytes; the answer to a parameter or a write has fewer."""


@dataclass(frozen=True)
class Seen:
    """``rate``: answered polls a second; ``octets``: bytes of all answered exchanges a second; ``gaps``: from
    an answer's last byte to the next request's first."""

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
    """The host's doings in a stretch of the record that lasted ``seconds``."""
    said: dict[int, int] = {}
    gaps: list[float] = []
    answered_at: float | None = None
    asked = octets = 0
    for entry in entries:
        if entry.what is Happened.SENT:
            answered_at = entry.at
            octets += asked + len(entry.data)
            asked = 0
        elif entry.what is Happened.RESPONDED and len(entry.data) >= SHORTEST_POLL_ANSWER:
            said[entry.unit] = said.get(entry.unit, 0) + 1
        elif entry.what is Happened.CAME:
            asked = len(entry.data)
            if answered_at is not None:
                gaps.append(entry.at - answered_at)
                answered_at = None
    per_unit = {unit: count / seconds for unit, count in sorted(said.items())}
    return Seen(sum(per_unit.values()), octets / seconds, per_unit, gaps)

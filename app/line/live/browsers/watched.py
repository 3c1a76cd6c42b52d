"""Which units and traces the open pages show. Pure.

Counted as pages come, go and turn: what a page costs depends on what it shows, not on how many there are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from functools import lru_cache

from app.line.live.screen.fields import unit_key

MAX_VIEWS = 64
"""Sets of units that pages show at a time."""
ShownUnits = frozenset[tuple[str, int]]
"""Units, each as bus and address."""


class Watched:
    """``units``: those that there are, by bus."""

    def __init__(self, units: Mapping[str, Collection[int]]) -> None:
        self._by_key = {unit_key(bus, unit): (bus, unit) for bus, of_bus in units.items() for unit in of_bus}
        self._units: dict[str, Counter[int]] = {bus: Counter() for bus in units}
        self._traces: Counter[str] = Counter()
        self.known = lru_cache(MAX_VIEWS)(self._known)
        """Returns the units of these keys that exist. One set for all pages that show the same: for a long
        line it is fifty kilobytes."""

    def _known(self, keys: tuple[str, ...]) -> ShownUnits:
        return frozenset(self._by_key[key] for key in keys if key in self._by_key)

    def turn(self, before: ShownUnits, after: ShownUnits, trace_before: str, trace_after: str) -> None:
        """A page shows other units and follows another trace; all of them are known."""
        for bus, unit in after - before:
            self._units[bus][unit] += 1
        for bus, unit in before - after:
            self._units[bus][unit] -= 1
        self._traces[trace_before] -= 1
        self._traces[trace_after] += 1

    def units(self, bus: str) -> list[int]:
        """Those that some page shows."""
        return sorted(unit for unit, pages in self._units[bus].items() if pages)

    def is_traced(self, bus: str) -> bool:
        """Whether some page follows the frames of this bus."""
        return self._traces[bus] > 0

"""Which writes to a unit were under way at once: of these, the value before each is not known. Pure."""

from __future__ import annotations

from collections.abc import Iterable


class WritesUnderWay:
    """Of one bus."""

    def __init__(self) -> None:
        self._units: dict[int, frozenset[int]] = {}
        self._shared: set[int] = set()
        self._next = 0

    def begin(self, units: Iterable[int]) -> int:
        """A write to these units begins; returns its number."""
        number, written = self._next, frozenset(units)
        others = [other for other, theirs in self._units.items() if written & theirs]
        if others:
            self._shared |= {number, *others}
        self._units[number] = written
        self._next += 1
        return number

    def end(self, number: int) -> bool:
        """The write is over. Returns whether no other was under way to one of its units."""
        del self._units[number]
        alone = number not in self._shared
        self._shared.discard(number)
        return alone

"""The clock that the servers of a site share: that of their store.

The clocks of two machines may differ by an hour, so an arrival is passed on as a time of the store. Each
server compares that with its own monotonic clock once a second. Both conversions err to the early side, so
that a command never seems younger than it is.
"""

from __future__ import annotations

from dataclasses import dataclass

from bus.instants import Monotonic, UnixTime

KNOWN_FOR_S = 10.0
"""After so long without a comparison, the time of the store is not known."""


@dataclass(slots=True)
class StoreClock:
    """The offset of the store's clock. Pure: every time is passed in."""

    _least: float = 0.0
    _most: float = 0.0
    _compared_at: Monotonic = Monotonic(float("-inf"))

    def compare(self, before: Monotonic, read: UnixTime, after: Monotonic) -> None:
        """The store had the time ``read`` at some moment between ``before`` and ``after``."""
        self._least, self._most = float(read) - float(after), float(read) - float(before)
        self._compared_at = after

    def is_known(self, now: Monotonic) -> bool:
        return now - self._compared_at < KNOWN_FOR_S

    def to_store(self, at: Monotonic) -> UnixTime:
        """The earliest time of the store that a moment of this machine can be."""
        return UnixTime(float(at) + self._least)

    def from_store(self, at: UnixTime) -> Monotonic:
        """The earliest moment of this machine that a time of the store can be."""
        return Monotonic(float(at) - self._most)

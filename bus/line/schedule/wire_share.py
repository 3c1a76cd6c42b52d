"""A right to a fraction of the wire's time."""

from __future__ import annotations

from bus.instants import Monotonic


class WireShare:
    """Limits a use of the wire to at most ``fraction`` of the time, however long one use is.

    Unused time can be saved up for ``burst_s`` seconds of waiting, so that short uses between long ones of
    others still reach the complete fraction. Pure: ``now`` in seconds is passed in.
    """

    def __init__(self, fraction: float, burst_s: float = 0.0) -> None:
        self.fraction = fraction
        self.burst_s = burst_s
        self._ready_at = Monotonic(float("-inf"))

    def ready(self, now: Monotonic) -> bool:
        """Whether it may be used now."""
        return now >= self._ready_at

    @property
    def ready_at(self) -> Monotonic:
        """The moment from which it may be used."""
        return self._ready_at

    def spend(self, now: Monotonic, seconds: float) -> None:
        """It was used for ``seconds``, beginning at ``now``."""
        self._ready_at = max(self._ready_at, now - self.burst_s) + seconds / self.fraction

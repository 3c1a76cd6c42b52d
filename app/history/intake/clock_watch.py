"""Notice when this machine's clock was set. Pure: both clocks' times are passed in."""

from __future__ import annotations

from bus.instants import Monotonic, UnixTime

MIN_STEP_S = 1.0


class ClockWatch:
    """Compares the wall clock with one that only runs. A slow correction is no step."""

    def __init__(self, wall: UnixTime, running: Monotonic) -> None:
        self._difference = float(wall) - float(running)

    def step(self, wall: UnixTime, running: Monotonic) -> float:
        """The seconds by which the wall clock was set since the last call; 0.0 when it was not."""
        before, self._difference = self._difference, float(wall) - float(running)
        moved = self._difference - before
        return moved if abs(moved) >= MIN_STEP_S else 0.0

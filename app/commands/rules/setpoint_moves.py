"""How far each unit's setpoint was moved lately, for the limit per minute. Pure: the time is passed in."""

from __future__ import annotations

from collections import deque
from contextlib import suppress

from bus.instants import UnixTime

WINDOW_S = 60.0


class Moves:
    """Steps of the last minute, by unit of one bus."""

    def __init__(self) -> None:
        self._steps: dict[int, deque[tuple[UnixTime, int]]] = {}

    def note(self, unit: int, step: int, at: UnixTime) -> None:
        """A setpoint was moved by ``step``."""
        self._steps.setdefault(unit, deque()).append((at, step))

    def take_back(self, unit: int, step: int, at: UnixTime) -> None:
        """The step noted for ``at`` did not happen."""
        with suppress(ValueError):
            self._steps.get(unit, deque()).remove((at, step))

    def within_a_minute(self, unit: int, now: UnixTime) -> int:
        """The sum of all steps of the last minute."""
        steps = self._steps.get(unit)
        if steps is None:
            return 0
        while steps and steps[0][0] <= now - WINDOW_S:
            steps.popleft()
        return sum(step for _, step in steps)

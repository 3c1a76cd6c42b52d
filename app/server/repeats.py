"""What may repeat without end is logged once, then as a count. Pure: times are monotonic and passed in."""

from __future__ import annotations

from dataclasses import dataclass

from bus.instants import Monotonic

WINDOW_S = 60.0
MAX_KEYS = 100
OTHERS = "others"
"""Stands for every key beyond."""


@dataclass(slots=True)
class _Repeated:
    since: Monotonic
    count: int = 0


class Repeats:
    """Counts what follows the first of each key, a minute at a time."""

    def __init__(self) -> None:
        self._counted: dict[str, _Repeated] = {}

    def is_first(self, key: str, now: Monotonic) -> bool:
        """Whether this is the first of ``key`` for a minute; otherwise it is counted."""
        if key not in self._counted and len(self._counted) >= MAX_KEYS:
            key = OTHERS
        repeated = self._counted.get(key)
        if repeated is None:
            self._counted[key] = _Repeated(now)
            return True
        repeated.count += 1
        return False

    def take_counts(self, now: Monotonic) -> dict[str, int]:
        """How many followed the first, by key, of each minute that has passed."""
        over = {key: each for key, each in self._counted.items() if now - each.since >= WINDOW_S}
        for key, repeated in over.items():
            if repeated.count:
                self._counted[key] = _Repeated(now)
            else:
                del self._counted[key]
        return {key: repeated.count for key, repeated in over.items() if repeated.count}

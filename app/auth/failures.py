"""How many sign-ins may fail. Pure: the time is passed in."""

from __future__ import annotations

from collections import defaultdict, deque

WINDOW_S = 300.0
PER_NAME = 10
PER_PANEL = 5
"""A PIN has few digits."""
PER_ADDRESS = 30
"""More people than one sit behind a proxy."""
SWEEP_ABOVE = 10_000
"""Names and addresses kept before those that are over are forgotten."""


class Failures:
    """Failed sign-ins by name and by address over the last five minutes."""

    def __init__(self) -> None:
        self._at: defaultdict[str, deque[float]] = defaultdict(deque)

    def too_many(self, name: str, address: str, now: float, *, panel: bool) -> bool:
        """Whether nothing more is tried for now."""
        by_name, by_address = self._count(f"name {name}", now), self._count(f"address {address}", now)
        return by_name >= (PER_PANEL if panel else PER_NAME) or by_address >= PER_ADDRESS

    def note(self, name: str, address: str, now: float) -> None:
        """One more failed."""
        if len(self._at) > SWEEP_ABOVE:
            for key in list(self._at):
                self._count(key, now)
        self._at[f"name {name}"].append(now)
        self._at[f"address {address}"].append(now)

    def forget(self, name: str) -> None:
        """The right secret was given."""
        self._at.pop(f"name {name}", None)

    def _count(self, key: str, now: float) -> int:
        times = self._at.get(key)
        if times is None:
            return 0
        while times and now - times[0] >= WINDOW_S:
            times.popleft()
        if not times:
            del self._at[key]
        return len(times)

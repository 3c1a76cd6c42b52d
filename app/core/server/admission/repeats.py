"""Notes what may repeat without end once, and then as a count. Pure: times are monotonic and passed in."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

from bus.instants import Monotonic

WINDOW_S = 60.0
MAX_KEYS = 100
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Repetition(Generic[Item]):
    """What came ``count`` times since it was last noted, the last of it as ``item``. ``is_of_others``: it is
    one of several that are counted together."""

    item: Item
    count: int
    is_of_others: bool


@dataclass(slots=True)
class _Window(Generic[Item]):
    item: Item
    since: Monotonic
    count: int = 0


class Repeats(Generic[Item]):
    """Counts what follows the first of each key, a minute at a time. Beyond ``max_keys`` different ones all
    others are one."""

    def __init__(self, max_keys: int = MAX_KEYS) -> None:
        self._max_keys = max_keys
        self._windows: dict[Hashable, _Window[Item]] = {}

    def note(self, key: Hashable, item: Item, now: Monotonic) -> Repetition[Item] | None:
        """Return ``item`` where it is the first of its key for a minute; otherwise it is counted."""
        if key not in self._windows and len(self._windows) >= self._max_keys:
            key = None
        window = self._windows.get(key)
        if window is None:
            self._windows[key] = _Window(item, now)
            return Repetition(item, 1, key is None)
        window.item = item
        window.count += 1
        return None

    def take_counted(self, now: Monotonic, *, everything: bool = False) -> list[Repetition[Item]]:
        """Take what followed the first, by key, of each minute that has passed, or of all; a minute in which
        nothing did is forgotten."""
        found = []
        for key, window in list(self._windows.items()):
            if not everything and now - window.since < WINDOW_S:
                continue
            del self._windows[key]
            if window.count:
                found.append(Repetition(window.item, window.count, key is None))
                self._windows[key] = _Window(window.item, now)
        return found

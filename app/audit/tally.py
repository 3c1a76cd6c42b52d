"""How often the same thing happened, so that what strangers can cause makes one event a minute. Pure."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from bus.instants import UnixTime

WINDOW_S = 60.0
MOST_KEYS = 20
"""How many of a group have separate events in a minute."""

Item = TypeVar("Item", bound=Hashable)


@dataclass(slots=True)
class _Window(Generic[Item]):
    item: Item
    began: UnixTime
    count: int = 0
    last: UnixTime = UnixTime(0.0)


@dataclass(frozen=True, slots=True)
class Counted(Generic[Item]):
    """What happened ``count`` times since it was last recorded; ``last``: when, Unix time in seconds.
    ``is_many``: ``item`` is the last of several that are counted together."""

    item: Item
    count: int
    last: UnixTime
    is_many: bool


class Tally(Generic[Item]):
    """Counts items by group. Beyond `MOST_KEYS` different ones all others of a group are one."""

    def __init__(self) -> None:
        self._groups: dict[str, dict[Item | None, _Window[Item]]] = {}

    def note(self, group: str, item: Item, now: UnixTime) -> Counted[Item] | None:
        """Count an item; return it where it must be recorded at once, else None."""
        windows = self._groups.setdefault(group, {})
        key = item if item in windows or len(windows) < MOST_KEYS else None
        if key not in windows:
            windows[key] = _Window(item, now)
            return Counted(item, 1, now, key is None)
        window = windows[key]
        window.item, window.last = item, now
        window.count += 1
        return None

    def due(self, now: UnixTime) -> list[Counted[Item]]:
        """What was counted in windows that are over. A window in which nothing was is forgotten; one that
        began later than ``now`` is over too, for the clock was set back."""
        return list(self._take(lambda window: not 0 <= now - window.began < WINDOW_S, now))

    def rest(self, now: UnixTime) -> list[Counted[Item]]:
        """Everything counted and not recorded yet."""
        return list(self._take(lambda _: True, now))

    def _take(self, is_over: Callable[[_Window[Item]], bool], now: UnixTime) -> Iterator[Counted[Item]]:
        for windows in self._groups.values():
            for key, window in list(windows.items()):
                if not is_over(window):
                    continue
                if window.count:
                    yield Counted(window.item, window.count, window.last, key is None)
                    windows[key] = _Window(window.item, now)
                else:
                    del windows[key]

"""How often the same thing happened, so that what strangers can cause makes one event a minute. Pure."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from bus.instants import UnixTime

WINDOW_S = 60.0
MOST_KEYS = 20
"""How many of a group have events of their own in a minute."""

Item = TypeVar("Item", bound=Hashable)


@dataclass(slots=True)
class _Window(Generic[Item]):
    said: Item
    began: UnixTime
    count: int = 0
    last: UnixTime = UnixTime(0.0)


@dataclass(frozen=True, slots=True)
class Counted(Generic[Item]):
    """What happened ``count`` times more since it was last told; ``last``: when, Unix time in seconds.
    ``is_many``: ``said`` is the last of several that are counted together."""

    said: Item
    count: int
    last: UnixTime
    is_many: bool


class Tally(Generic[Item]):
    """Counts what is said, by group. Beyond `MOST_KEYS` different ones all others of a group are one."""

    def __init__(self) -> None:
        self._groups: dict[str, dict[Item | None, _Window[Item]]] = {}

    def note(self, group: str, said: Item, now: UnixTime) -> Counted[Item] | None:
        """It happened: gives what is to be told at once, None where it is counted."""
        windows = self._groups.setdefault(group, {})
        key = said if said in windows or len(windows) < MOST_KEYS else None
        if key not in windows:
            windows[key] = _Window(said, now)
            return Counted(said, 1, now, key is None)
        window = windows[key]
        window.said, window.last = said, now
        window.count += 1
        return None

    def due(self, now: UnixTime) -> list[Counted[Item]]:
        """What was counted in windows that are over. A window in which nothing was is forgotten; one that
        began later than ``now`` is over too, for the clock was set back."""
        return list(self._take(lambda window: not 0 <= now - window.began < WINDOW_S, now))

    def rest(self, now: UnixTime) -> list[Counted[Item]]:
        """Everything that was counted and not told yet."""
        return list(self._take(lambda _: True, now))

    def _take(self, is_over: Callable[[_Window[Item]], bool], now: UnixTime) -> Iterator[Counted[Item]]:
        for windows in self._groups.values():
            for key, window in list(windows.items()):
                if not is_over(window):
                    continue
                if window.count:
                    yield Counted(window.said, window.count, window.last, key is None)
                    windows[key] = _Window(window.said, now)
                else:
                    del windows[key]

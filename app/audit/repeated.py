"""Bounds the events that strangers can cause: repetitions are counted and recorded once a minute."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

from app.audit.kinds import EventKind
from app.errors import StoreError
from bus.instants import Clock, UnixTime
from bus.messages import Message

WINDOW_S = 60.0
MAX_KEYS = 20
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
    """Counts items by group. Beyond `MAX_KEYS` different ones all others of a group are one."""

    def __init__(self) -> None:
        self._groups: dict[str, dict[Item | None, _Window[Item]]] = {}

    def note(self, group: str, item: Item, now: UnixTime) -> Counted[Item] | None:
        """Count an item; return it where it must be recorded at once, else None."""
        windows = self._groups.setdefault(group, {})
        key = item if item in windows or len(windows) < MAX_KEYS else None
        if key not in windows:
            windows[key] = _Window(item, now)
            return Counted(item, 1, now, key is None)
        window = windows[key]
        window.item, window.last = item, now
        window.count += 1
        return None

    def due(self, now: UnixTime, *, everything: bool = False) -> list[Counted[Item]]:
        """What was counted in windows that are over, or in all. A window in which nothing was is forgotten;
        one that began later than ``now`` is over too, for the clock was set back."""
        found: list[Counted[Item]] = []
        for windows in self._groups.values():
            for key, window in list(windows.items()):
                if not everything and 0 <= now - window.began < WINDOW_S:
                    continue
                del windows[key]
                if window.count:
                    found.append(Counted(window.item, window.count, window.last, key is None))
                    windows[key] = _Window(window.item, now)
        return found


MANY = Message("many_addresses")
"""The origin of events that are counted for more places than are kept apart."""
_Text = str | Message
_RepeatedEvent = tuple[EventKind, _Text, _Text, _Text, _Text]
"""Kind, what, who, origin and message."""


class RepeatedEvents:
    """An event at once for the first of its kind, person, place and message, then one a minute with the
    number of repetitions. Places are kept apart for each person, so that a flood hides no one who is under
    attack: ``who`` is one of a bounded number. ``record``: as `EventLog.record`; ``clock`` gives Unix time in
    seconds."""

    def __init__(self, record: Callable[..., Awaitable[int]], clock: Clock) -> None:
        self._record = record
        self._clock = clock
        self._tally: Tally[_RepeatedEvent] = Tally()

    async def count(
        self, kind: EventKind, what: _Text, *, who: _Text = "", origin: _Text = "", message: _Text = ""
    ) -> None:
        """Something that a stranger can cause as often as they like."""
        counted = self._tally.note(f"{kind} {who}", (kind, what, who, origin, message), self._clock())
        if counted is not None:
            await self._record_counted(counted)

    async def follow(self) -> None:
        """Record what was counted in minutes that are over, without end."""
        while True:
            await asyncio.sleep(WINDOW_S / 4)
            await self.record_due()

    async def record_due(self, *, everything: bool = False) -> None:
        """Record what was counted in minutes that are over; when the server ends, ``everything``.

        Raises StoreError once each was tried.
        """
        failed: StoreError | None = None
        for counted in self._tally.due(self._clock(), everything=everything):
            try:
                await self._record_counted(counted)
            except StoreError as error:
                failed = error
        if failed is not None:
            raise failed

    async def _record_counted(self, counted: Counted[_RepeatedEvent]) -> None:
        kind, what, who, origin, message = counted.item
        if counted.is_many:
            origin, message = MANY, ""
        at, count = counted.last, counted.count
        await self._record(kind=kind, what=what, who=who, origin=origin, message=message, at=at, count=count)

"""Bounds the events that strangers can cause: repetitions are counted and recorded once a minute."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Awaitable, Callable
from functools import partial

from app.core.server.refusal_log import WINDOW_S, Repeats, Repetition
from app.errors import StoreError
from app.people.audit.entry import EventKind
from bus.instants import Clock, MonotonicClock, UnixTime, monotonic_now
from bus.messages import Message

MAX_KEYS = 20
"""How many of a group have separate events in a minute."""
MANY = Message("many_addresses")
"""The origin of events that are counted for more places than are kept apart."""
_Text = str | Message
_RepeatedEvent = tuple[EventKind, _Text, _Text, _Text, _Text, UnixTime]
"""Kind, what, who, origin, message and time."""


class RepeatedEvents:
    """An event at once for the first of its kind, person, place and message, then one a minute with the
    number of repetitions. Places are kept apart for each person, so that a flood hides no one who is under
    attack: ``who`` is one of a bounded number. ``record``: as `EventLog.record`; ``clock`` gives Unix time in
    seconds, ``now`` measures the minutes."""

    def __init__(
        self, record: Callable[..., Awaitable[object]], clock: Clock, now: MonotonicClock = monotonic_now
    ) -> None:
        self._record = record
        self._clock = clock
        self._now = now
        self._groups: dict[tuple[EventKind, _Text], Repeats[_RepeatedEvent]] = defaultdict(
            partial(Repeats, MAX_KEYS)
        )

    async def count(
        self, kind: EventKind, what: _Text, *, who: _Text = "", origin: _Text = "", message: _Text = ""
    ) -> None:
        """Count one more of what a stranger can cause as often as they like."""
        event = (kind, what, who, origin, message, self._clock())
        first = self._groups[kind, who].note((what, origin, message), event, self._now())
        if first is not None:
            await self._record_counted(first)

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
        now = self._now()
        for repeats in list(self._groups.values()):
            for counted in repeats.take_counted(now, everything=everything):
                try:
                    await self._record_counted(counted)
                except StoreError as error:
                    failed = error
        if failed is not None:
            raise failed

    async def _record_counted(self, counted: Repetition[_RepeatedEvent]) -> None:
        kind, what, who, origin, message, at = counted.item
        if counted.is_of_others:
            origin, message = MANY, ""
        fields = {"what": what, "who": who, "origin": origin, "message": message}
        await self._record(kind=kind, at=at, count=counted.count, **fields)

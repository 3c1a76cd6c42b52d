"""Events that a stranger can cause as often as they like, in a number that is bounded."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from app.audit.kinds import EventKind
from app.audit.tally import WINDOW_S, Counted, Tally
from bus.instants import Clock
from bus.messages import Message

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

    async def count(self, kind: EventKind, what: _Text, *, who: _Text, origin: _Text, message: _Text) -> None:
        """Count one repetition."""
        counted = self._tally.note(f"{kind} {who}", (kind, what, who, origin, message), self._clock())
        if counted is not None:
            await self._record_counted(counted)

    async def follow(self) -> None:
        """Record what was counted in minutes that are over, without end."""
        while True:
            await asyncio.sleep(WINDOW_S / 4)
            await self.record_due()

    async def record_due(self) -> None:
        """Record what was counted in minutes that are over."""
        for counted in self._tally.due(self._clock()):
            await self._record_counted(counted)

    async def record_rest(self) -> None:
        """Record everything that was counted: the server ends."""
        for counted in self._tally.rest(self._clock()):
            await self._record_counted(counted)

    async def _record_counted(self, counted: Counted[_RepeatedEvent]) -> None:
        kind, what, who, origin, message = counted.item
        if counted.is_many:
            origin, message = MANY, ""
        await self._record(
            kind=kind,
            what=what,
            who=who,
            origin=origin,
            message=message,
            at=counted.last,
            count=counted.count,
        )

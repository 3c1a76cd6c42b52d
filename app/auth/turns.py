"""Whose password is hashed next, which takes 20 ms of a core: one at a time of each place.

Places take turns, and so do those that have signed in before and those that have not: whoever sends ever so
many sign-ins delays their own. What waits is bounded.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

AT_ONCE = 2
"""As many as there are threads for it."""
MOST_OF_ONE = 5
MOST_WAITING = 200
"""Two seconds' worth; half of them at most from places that never signed in."""


class TooManyWaitingError(Exception):
    """Nothing more is put into the queue."""


class _Queue:
    """One class of places: each with what waits, in the order in which they have their turn."""

    def __init__(self) -> None:
        self._waiting: OrderedDict[str, deque[asyncio.Future[None]]] = OrderedDict()
        self.count = 0

    def waiting_of(self, key: str) -> int:
        return len(self._waiting.get(key, ()))

    def put(self, key: str, turn: asyncio.Future[None]) -> None:
        self._waiting.setdefault(key, deque()).append(turn)
        self.count += 1

    def discard(self, key: str, turn: asyncio.Future[None]) -> None:
        turns = self._waiting.get(key)
        if turns is None or turn not in turns:
            return
        turns.remove(turn)
        self.count -= 1
        if not turns:
            del self._waiting[key]

    def next(self, busy: set[str]) -> tuple[str, asyncio.Future[None]] | None:
        """The first of the next place that is not busy; that place goes to the end."""
        for key in self._waiting:
            if key not in busy:
                turn = self._waiting[key][0]
                self.discard(key, turn)
                if key in self._waiting:
                    self._waiting.move_to_end(key)
                return key, turn
        return None


class Turns:
    """``async with turns.of(place, known=…):`` waits for its turn."""

    def __init__(self, at_once: int = AT_ONCE) -> None:
        self._at_once = at_once
        self._queues = {True: _Queue(), False: _Queue()}
        self._busy: set[str] = set()
        self._known_next = True

    @asynccontextmanager
    async def of(self, key: str, *, known: bool) -> AsyncIterator[None]:
        """Raises TooManyWaitingError where this place, or all together, have enough waiting."""
        await self._wait(key, known)
        try:
            yield
        finally:
            self._busy.discard(key)
            self._call_next()

    async def _wait(self, key: str, known: bool) -> None:
        queue = self._queues[known]
        if queue.waiting_of(key) >= MOST_OF_ONE or queue.count >= MOST_WAITING // 2:
            raise TooManyWaitingError
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        queue.put(key, turn)
        self._call_next()
        try:
            await turn
        except asyncio.CancelledError:
            queue.discard(key, turn)
            if not turn.cancelled():
                self._busy.discard(key)
                self._call_next()
            raise

    def _call_next(self) -> None:
        while len(self._busy) < self._at_once and (found := self._next()) is not None:
            key, turn = found
            if not turn.cancelled():
                self._busy.add(key)
                turn.set_result(None)

    def _next(self) -> tuple[str, asyncio.Future[None]] | None:
        """Of the two queues in turn, where both have somebody."""
        for known in (self._known_next, not self._known_next):
            found = self._queues[known].next(self._busy)
            if found is not None:
                self._known_next = not known
                return found
        return None

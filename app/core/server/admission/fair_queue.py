"""A queue with turns, for what costs much: keys (places, accounts) take turns, and so do those that are known
and those that are not. However much comes of one key delays that key. What waits is bounded."""

from __future__ import annotations

import asyncio
from collections import Counter, OrderedDict, deque
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from math import inf
from types import MappingProxyType
from typing import Generic, TypeVar

K = TypeVar("K")

MAX_REST_S = 0.05


class TooManyWaitingError(Exception):
    """Nothing more is put into the queue."""


class RoundRobin(Generic[K]):
    """What waits, by key; the keys have their turn one after the other."""

    def __init__(self) -> None:
        self._turns: OrderedDict[K, deque[asyncio.Future[None]]] = OrderedDict()
        self.count = 0

    def count_of(self, key: K) -> int:
        return len(self._turns.get(key, ()))

    def put(self, key: K, turn: asyncio.Future[None]) -> None:
        self._turns.setdefault(key, deque()).append(turn)
        self.count += 1

    def discard(self, key: K, turn: asyncio.Future[None]) -> None:
        turns = self._turns.get(key)
        if turns is None or turn not in turns:
            return
        turns.remove(turn)
        self.count -= 1
        if not turns:
            del self._turns[key]

    def next(
        self, busy: Mapping[K, int] = MappingProxyType({}), at_once_of_key: int = 1
    ) -> tuple[K, asyncio.Future[None]] | None:
        """Return the first of the next key that may have one more turn beside those that are ``busy``; that
        key goes to the end."""
        for key in self._turns:
            if busy.get(key, 0) < at_once_of_key:
                turn = self._turns[key][0]
                self.discard(key, turn)
                if key in self._turns:
                    self._turns.move_to_end(key)
                return key, turn
        return None


class FairQueue(Generic[K]):
    """``async with queue.turn(key):`` waits for its turn.

    ``at_once``: turns at a time, and ``at_once_of_key`` of one key. ``most_waiting_of_key`` may wait of one
    key, ``most_waiting`` of all together, half of them known and half not. ``rest``: how many times as long
    as a turn took its place then stays free, but at most ``most_rest_s``.
    """

    def __init__(
        self,
        at_once: float,
        at_once_of_key: int,
        most_waiting_of_key: int,
        most_waiting: float = inf,
        rest: float = 0.0,
        most_rest_s: float = MAX_REST_S,
    ) -> None:
        self._at_once = at_once
        self._at_once_of_key = at_once_of_key
        self._most_of_key = at_once_of_key + most_waiting_of_key
        self._most_waiting_of_class = most_waiting / 2
        self._rest = rest
        self._most_rest_s = most_rest_s
        self._waiting: dict[bool, RoundRobin[K]] = {True: RoundRobin(), False: RoundRobin()}
        self._busy: Counter[K] = Counter()
        self._known_next = True

    @asynccontextmanager
    async def turn(self, key: K, *, known: bool = True) -> AsyncIterator[None]:
        """Wait for a turn. Raises TooManyWaitingError where this key, or all together, have enough
        waiting."""
        await self._wait(key, known)
        loop = asyncio.get_running_loop()
        begun = loop.time()
        try:
            yield
        finally:
            if self._rest:
                loop.call_later(min(self._rest * (loop.time() - begun), self._most_rest_s), self._end, key)
            else:
                self._end(key)

    def count_of(self, key: K) -> int:
        """Return how many turns a key has, those that wait included."""
        return self._busy[key] + sum(waiting.count_of(key) for waiting in self._waiting.values())

    async def _wait(self, key: K, known: bool) -> None:
        waiting = self._waiting[known]
        must_wait = self._busy.total() >= self._at_once or self._busy[key] >= self._at_once_of_key
        if self.count_of(key) >= self._most_of_key or (
            must_wait and waiting.count >= self._most_waiting_of_class
        ):
            raise TooManyWaitingError
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        waiting.put(key, turn)
        self._call_next()
        try:
            await turn
        except asyncio.CancelledError:
            waiting.discard(key, turn)
            if not turn.cancelled():
                self._end(key)
            raise

    def _end(self, key: K) -> None:
        self._busy[key] -= 1
        if not self._busy[key]:
            del self._busy[key]
        self._call_next()

    def _call_next(self) -> None:
        while self._busy.total() < self._at_once and (found := self._next()) is not None:
            key, turn = found
            if not turn.cancelled():
                self._busy[key] += 1
                turn.set_result(None)

    def _next(self) -> tuple[K, asyncio.Future[None]] | None:
        """Return the next of the two classes in turn, where both are waiting."""
        for known in (self._known_next, not self._known_next):
            found = self._waiting[known].next(self._busy, self._at_once_of_key)
            if found is not None:
                self._known_next = not known
                return found
        return None

"""Turns, so that a load from one sender delays that sender and no other."""

from __future__ import annotations

import asyncio
from collections import Counter, OrderedDict, deque
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from math import inf
from typing import Generic, TypeVar

K = TypeVar("K")

MAX_REST_S = 0.05


class LoopTurns:
    """A scheduler that runs one function in an iteration of the event loop; keys take turns.

    After a turn of a key that has more waiting, the event loop stays free for as long as the turn took, what
    it started included: a command needs the loop some twenty times, and would otherwise wait for another turn
    each time.
    """

    def __init__(self) -> None:
        self._waiting: dict[object, deque[Callable[[], None]]] = {}
        self._is_taken = False

    def run(self, key: object, start: Callable[[], None]) -> None:
        """Call ``start`` at once if nothing had a turn in this iteration of the event loop, else in the turn
        of ``key``."""
        if self._is_taken:
            self._waiting.setdefault(key, deque()).append(start)
        else:
            self._take(key, start)

    def _take(self, key: object, start: Callable[[], None]) -> None:
        loop = asyncio.get_running_loop()
        self._is_taken, begun = True, loop.time()
        try:
            start()
        finally:
            # This is called after the first step of a task that `start` has made.
            loop.call_soon(self._rest, key, begun)

    def _rest(self, key: object, begun: float) -> None:
        loop = asyncio.get_running_loop()
        if key in self._waiting:
            loop.call_later(loop.time() - begun, self._next)
        else:
            self._next()

    def _next(self) -> None:
        if not self._waiting:
            self._is_taken = False
            return
        key = next(iter(self._waiting))
        starts = self._waiting.pop(key)
        start = starts.popleft()
        if starts:
            self._waiting[key] = starts
        self._take(key, start)


class TooManyWaitingError(Exception):
    """Raised when the queue of turns is full."""


class FairQueue(Generic[K]):
    """A queue for costly work; ``async with queue.turn(key):`` waits for its turn. Keys (places, accounts)
    take turns, and so do the known and the unknown ones.

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
        self._waiting: dict[bool, _RoundRobin[K]] = {True: _RoundRobin(), False: _RoundRobin()}
        self._busy: Counter[K] = Counter()
        self._known_next = True

    @asynccontextmanager
    async def turn(self, key: K, *, known: bool = True) -> AsyncIterator[None]:
        """Wait for a turn. Raise TooManyWaitingError if this key, or all together, have enough waiting."""
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
        """Return the number of turns of a key, those that wait included."""
        return self._busy[key] + sum(waiting.count_of(key) for waiting in self._waiting.values())

    async def _wait(self, key: K, known: bool) -> None:
        waiting = self._waiting[known]
        must_wait = self._busy.total() >= self._at_once or self._busy[key] >= self._at_once_of_key
        if self.count_of(key) >= self._most_of_key or (
            must_wait and waiting.count >= self._most_waiting_of_class
        ):
            raise TooManyWaitingError
        if not must_wait:
            self._busy[key] += 1
            return
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
        """Return the next waiter; if both classes wait, they take turns."""
        for known in (self._known_next, not self._known_next):
            found = self._waiting[known].next(self._busy, self._at_once_of_key)
            if found is not None:
                self._known_next = not known
                return found
        return None


class _RoundRobin(Generic[K]):
    """The turns that wait, by key; the keys are served one after the other."""

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

    def next(self, busy: Mapping[K, int], at_once_of_key: int) -> tuple[K, asyncio.Future[None]] | None:
        """Return the first turn of the next key that may have one more beside those that are ``busy``; that
        key goes to the end."""
        for key in self._turns:
            if busy.get(key, 0) < at_once_of_key:
                turn = self._turns[key][0]
                self.discard(key, turn)
                if key in self._turns:
                    self._turns.move_to_end(key)
                return key, turn
        return None

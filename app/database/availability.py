"""Whether the database of another machine responds.

What waits for it waits for a bounded time, and is given up at once when it is away: neither the event loop
nor a command that stops a line waits for a database.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import TypeVar

import structlog

from app.errors import StoreError, StoreUnavailableError
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

T = TypeVar("T")
PROBE_EVERY_S = 0.25
PROBE_WITHIN_S = 0.5
"""How long a trivial read may take: a click on a speed of 0 is sent within two seconds, or not at all."""
MAX_WAIT_S = 10.0
"""How long anything else may take while the database responds to trivial reads."""
NO_RESPONSE = Message("store_no_response")
UNKNOWN_RESULT = Message("store_result_unknown")
log = structlog.get_logger()


class Availability:
    """``away_since``: since when the database is away, None while it is there. ``before_return``: called when
    it responds again; only once that has returned is the database there for everything else."""

    def __init__(self, clock: Clock = unix_now) -> None:
        self.away_since: UnixTime | None = None
        self.back_since: UnixTime | None = None
        self._clock = clock
        self._fault = ""
        """Why it was not there when it responded last."""
        self._waiting: set[asyncio.Future[object]] = set()
        self._probing: asyncio.Future[object] | None = None
        self.before_return: Callable[[], Awaitable[None]] | None = None

    @property
    def is_away(self) -> bool:
        return self.away_since is not None

    def refuse_while_away(self) -> None:
        """Raises StoreUnavailableError where the database is known to be away: nothing is tried."""
        if self.is_away:
            raise StoreUnavailableError(NO_RESPONSE)

    def lost(self, reason: Message) -> None:
        """The database does not respond, or cannot be written: give up all that waits for it."""
        if self.is_away:
            return
        self.away_since = self._clock()
        log.error("database away", error=str(reason))
        for waiting in tuple(self._waiting):
            if not waiting.done():
                waiting.set_exception(StoreUnavailableError(UNKNOWN_RESULT))

    async def within(self, work: asyncio.Future[T], limit_s: float = MAX_WAIT_S) -> T:
        """The result of ``work``, which a thread does. Raises StoreUnavailableError once the database is
        away; what a thread has begun may still be stored."""
        loop = asyncio.get_running_loop()
        outcome: asyncio.Future[object] = loop.create_future()
        limit = loop.call_later(limit_s, _give_up, outcome)
        self._waiting.add(outcome)
        work.add_done_callback(lambda done: _pass_on(done, outcome))
        try:
            result: T = await outcome  # type: ignore[assignment]
        except StoreUnavailableError as error:
            self.lost(error.message)
            raise
        finally:
            limit.cancel()
            self._waiting.discard(outcome)
            # What no thread has begun is not done; what has begun goes on to its end.
            work.cancel()
        return result

    async def watch(self, probe: Callable[[], asyncio.Future[object]]) -> None:
        """Run until canceled: notice that the database is away, and that it is back."""
        while True:
            await asyncio.sleep(PROBE_EVERY_S)
            fault = await self._probe(probe)
            if fault is not None:
                self.lost(fault)
            elif self.is_away:
                await self._come_back()

    async def end(self, probe: Callable[[], asyncio.Future[object]], interrupt: Callable[[], None]) -> None:
        """The server ends: where the database does not respond, ``interrupt`` what waits for it."""
        if self.is_away or await self._probe(probe) is not None:
            self.lost(NO_RESPONSE)
            interrupt()

    async def _probe(self, probe: Callable[[], asyncio.Future[object]]) -> Message | None:
        """Why the database does not respond; one probe at a time: those that hang would take every thread."""
        if self._probing is None:
            self._probing = probe()
        await asyncio.wait({self._probing}, timeout=PROBE_WITHIN_S)
        if not self._probing.done():
            return NO_RESPONSE
        done, self._probing = self._probing, None
        error = done.exception()
        if not isinstance(error, Exception):
            return None
        return (
            error.message if isinstance(error, StoreError) else Message.of("system_error", error=str(error))
        )

    async def _come_back(self) -> None:
        if self.before_return is not None:
            try:
                await self.before_return()
            except StoreError as error:
                if str(error) != self._fault:
                    log.error("database still away", error=str(error))
                self._fault = str(error)
                return
        log.info("database back", away_since=self.away_since)
        self.away_since, self.back_since, self._fault = None, self._clock(), ""


async def in_time(work: asyncio.Future[T], limit_s: float = MAX_WAIT_S) -> T:
    """The result of ``work``, which a thread does. Raises StoreUnavailableError where it takes too long."""
    # Where the caller is canceled the thread goes on, and that it fails then is no error of the program.
    work.add_done_callback(lambda done: done.cancelled() or done.exception())
    await asyncio.wait({work}, timeout=limit_s)
    if not work.done():
        work.cancel()
        raise StoreUnavailableError(UNKNOWN_RESULT)
    return work.result()


def _give_up(outcome: asyncio.Future[object]) -> None:
    if not outcome.done():
        outcome.set_exception(StoreUnavailableError(UNKNOWN_RESULT))


def _pass_on(done: asyncio.Future[T], outcome: asyncio.Future[object]) -> None:
    if done.cancelled():
        return
    error = done.exception()
    if outcome.done():
        return
    if error is None:
        outcome.set_result(done.result())
    else:
        with suppress(asyncio.InvalidStateError):
            outcome.set_exception(error)

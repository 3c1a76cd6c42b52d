"""When the watchdog of systemd is fed: the loop turns, the store takes what it is given, and each bus has its
worker or is about to. A port that is unplugged and a database that is away are no standstill.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import structlog

from app.database import Database, StoreConnection
from app.errors import StoreUnavailableError
from app.server.service_manager import PartsProgress, ServiceManager
from bus.errors import LinesideError
from bus.instants import MonotonicClock, monotonic_now

log = structlog.get_logger()

MAX_STILL_S = {"bus workers": 12.0, "store": 60.0}
"""How long each may stand still, in seconds. A disk may take longer over what it is given."""


class Liveness:
    """Call :meth:`tick` once a second on the event loop, which is thereby known to turn."""

    def __init__(
        self,
        manager: ServiceManager,
        database: Database,
        has_workers: Callable[[], bool],
        now: MonotonicClock = monotonic_now,
    ) -> None:
        self._manager = manager
        # Another machine's database is none of this process: it may be away for hours.
        self._look = (lambda: database.write_briefly(_look)) if database.availability is None else None
        self._has_workers = has_workers
        self._now = now
        self._progress = PartsProgress(MAX_STILL_S, now())
        self._looking: asyncio.Task[None] | None = None
        self._reported: list[str] = []

    def tick(self) -> None:
        """Feed the watchdog, unless a part stands still; that is logged once."""
        now = self._now()
        if self._has_workers():
            self._progress.moved("bus workers", now)
        if self._look is None or self._store_took_it(self._look):
            self._progress.moved("store", now)
        still = self._progress.stands_still(now)
        if not still:
            self._manager.alive()
        if still != self._reported:
            self._reported = still
            log.error("watchdog of systemd not fed" if still else "watchdog of systemd fed", parts=still)

    def _store_took_it(self, look: Callable[[], Awaitable[object]]) -> bool:
        """Whether the store has responded since the last tick. Then it is given the next look."""
        if self._looking is not None and not self._looking.done():
            return False
        error = self._looking.exception() if self._looking is not None else None
        self._looking = asyncio.create_task(_without_refusal(look), name="look at the store")
        return not isinstance(error, StoreUnavailableError)


async def _without_refusal(look: Callable[[], Awaitable[object]]) -> None:
    """A store that refuses, as on a full disk, has responded. Raises StoreUnavailableError."""
    try:
        await look()
    except StoreUnavailableError:
        raise
    except LinesideError:
        pass


def _look(connection: StoreConnection) -> object:
    return connection.execute("SELECT 1").fetchone()

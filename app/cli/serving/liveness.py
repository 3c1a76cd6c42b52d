"""When the watchdog of systemd is fed: the loop turns, the store takes what it is given, and each bus has its
worker or is about to. A port that is unplugged is no standstill.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

import structlog

from app.core.database import Database, StoreConnection
from app.core.server.service_manager import PartsProgress, ServiceManager
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
        self._database = database
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
        if self._store_took_it():
            self._progress.moved("store", now)
        still = self._progress.stands_still(now)
        if not still:
            self._manager.alive()
        if still != self._reported:
            self._reported = still
            log.error("watchdog of systemd not fed" if still else "watchdog of systemd fed", parts=still)

    def _store_took_it(self) -> bool:
        """Whether the store has responded since the last tick. Then it is given the next look."""
        if self._looking is not None and not self._looking.done():
            return False
        self._looking = asyncio.create_task(self._look(), name="look at the store")
        return True

    async def _look(self) -> None:
        # A store that refuses, as on a full disk, has responded.
        with suppress(LinesideError):
            await self._database.write(_look)


def _look(connection: StoreConnection) -> object:
    return connection.execute("SELECT 1").fetchone()

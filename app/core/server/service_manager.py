"""Messages to systemd that the server serves, restarts or stops, and the feeding of its watchdog
(sd_notify(3)).

Each message is a datagram to the socket that ``NOTIFY_SOCKET`` names; without one nothing is sent.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable, MutableMapping
from contextlib import suppress

import structlog

from app.core.database import Database, StoreConnection
from bus.errors import LinesideError
from bus.instants import MonotonicClock, monotonic_now

log = structlog.get_logger()

NOTIFY_SOCKET = "NOTIFY_SOCKET"
MAX_STILL_S = {"bus workers": 12.0, "store": 60.0}
"""How long each part may make no progress, in seconds. The store has longer, because a disk may be slow to
write."""


class ServiceManager:
    """The connection to the service manager by the socket of the environment, which the processes that are
    started here do not inherit."""

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        address = environment.pop(NOTIFY_SOCKET, "")
        # An abstract address is written with @ in place of its first byte, which is 0.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self.is_there = bool(address)

    def ready(self, status: str) -> None:
        """Tell systemd that the server responds. ``status``: a line for ``systemctl status``."""
        self._send("READY=1", f"STATUS={status}")

    def alive(self) -> None:
        """Feed the watchdog, which restarts its time."""
        self._send("WATCHDOG=1")

    def restarting(self, environment: MutableMapping[str, str] = os.environ) -> None:
        """Tell systemd that the server restarts in this process, and put the socket back into the environment
        for it."""
        self._send("RELOADING=1", "STATUS=restarts with the changed configuration")
        if self.is_there:
            environment[NOTIFY_SOCKET] = self._address.replace("\0", "@", 1)

    def stopping(self) -> None:
        self._send("STOPPING=1")

    def _send(self, *lines: str) -> None:
        if not self.is_there:
            return
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sending:
            # A manager that is busy or gone misses this message.
            sending.setblocking(False)
            sending.sendto("\n".join(lines).encode(), self._address)


class Liveness:
    """A task that feeds the watchdog of systemd while the event loop turns, the store accepts writes, and
    every bus has its worker or is about to. An unplugged port is no standstill. Call :meth:`tick` once a
    second on the event loop."""

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
        self._moved_at = dict.fromkeys(MAX_STILL_S, now())
        self._looking: asyncio.Task[None] | None = None
        self._reported: list[str] = []

    def tick(self) -> None:
        """Feed the watchdog unless a part makes no progress, which is logged once."""
        now = self._now()
        if self._has_workers():
            self._moved_at["bus workers"] = now
        if self._store_took_it():
            self._moved_at["store"] = now
        still = [part for part, at in self._moved_at.items() if now - at > MAX_STILL_S[part]]
        if not still:
            self._manager.alive()
        if still != self._reported:
            self._reported = still
            log.error("watchdog of systemd not fed" if still else "watchdog of systemd fed", parts=still)

    def _store_took_it(self) -> bool:
        """Return whether the store has responded since the last tick, and if so send it the next look."""
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

"""What runs for one bus while its home is here: its parts, and its port."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Protocol

import structlog

log = structlog.get_logger()


class Ports(Protocol):
    """The workers that this server runs beside its ports."""

    def start(self, bus: str) -> None:
        """Run the worker of a bus."""

    async def stop(self, bus: str) -> None:
        """End it; its port is closed when this returns."""


class _NoPorts:
    """Where another process runs the workers, or none does."""

    def start(self, bus: str) -> None:
        pass

    async def stop(self, bus: str) -> None:
        pass


NO_PORTS: Ports = _NoPorts()


class HomeLife:
    """One bus, or the site. ``lifetime``: its parts, loaded from the store each time."""

    def __init__(
        self, bus: str, lifetime: Callable[[], AbstractAsyncContextManager[None]], ports: Ports
    ) -> None:
        self._bus = bus
        self._lifetime = lifetime
        self._ports = ports
        self.held = asyncio.Event()
        self._lost = asyncio.Event()
        self.settled = asyncio.Event()
        """Set once its parts run, or could not start."""
        self.is_on = False

    def hold(self) -> None:
        """The lease was taken: what belongs to the bus begins."""
        self._lost.clear()
        self.is_on = True
        self.held.set()

    def lose(self) -> None:
        """It ends, the port first."""
        self.held.clear()
        self._lost.set()

    async def live(self) -> str | None:
        """Run until the home is lost; why it could not begin, or None."""
        try:
            async with self.running():
                await self._lost.wait()
        except Exception as error:
            log.exception("home ended", bus=self._bus or "site")
            self.held.clear()
            self.settled.set()
            return str(error) or type(error).__name__
        return None

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """The parts of the bus, and within them its port: that begins last, and ends first."""
        async with self._lifetime():
            self._ports.start(self._bus)
            self.settled.set()
            try:
                yield
            finally:
                await self._ports.stop(self._bus)

"""This server among those of its site: the homes, the secret and the clock that they share."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection
from dataclasses import dataclass, field

import structlog
from starlette.types import Scope

from app.database import Database
from app.errors import StoreError
from app.home.homes import Home
from app.routing.forwarding.hop import Hop, opened, sealed
from app.routing.homes import BusHomes
from app.routing.secret import site_secret
from app.routing.store_clock import StoreClock
from app.server.admission.turns import ARRIVED_AT
from bus.instants import Clock, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message

COMPARE_EVERY_S = 1.0
MAX_APART_S = 5
"""Up to here, times of this server and of others match for a person who compares them."""
STEADY_S = 2
"""A notice that counted each second would be read aloud each second."""
log = structlog.get_logger()


@dataclass(eq=False, repr=False)
class SiteServers:
    """``buses``: of the configuration."""

    homes: BusHomes
    buses: Collection[str]
    monotonic: MonotonicClock = monotonic_now
    clock: StoreClock = field(default_factory=StoreClock)
    wall_clock: Clock = unix_now
    _apart_s: int = 0
    _secret: bytes = b""

    async def load(self, database: Database) -> None:
        """Read the secret of the site, or make it. Raises StoreError."""
        self._secret = await database.write(site_secret)

    async def compare_clocks(self, read_clock: Callable[[], Awaitable[UnixTime]]) -> None:
        """Run until canceled: compare the clock of the store once a second."""
        while True:
            before = self.monotonic()
            try:
                self.clock.compare(before, await read_clock(), self.monotonic())
                self._note_apart(round(self.wall_clock() - self.clock.to_store(self.monotonic())))
            except StoreError as error:
                log.warning("clock of the store not read", why=str(error))
            await asyncio.sleep(COMPARE_EVERY_S)

    def _note_apart(self, apart_s: int) -> None:
        if abs(apart_s - self._apart_s) < STEADY_S:
            return
        self._apart_s = apart_s
        if (notice := self.clock_notice) is not None:
            log.warning("clock", why=str(notice))

    @property
    def clock_notice(self) -> Message | None:
        """For people, where the clock of this server and that of the store differ; None while they agree."""
        if abs(self._apart_s) <= MAX_APART_S:
            return None
        return Message.of("clocks_apart", seconds=abs(self._apart_s))

    @property
    def is_shared(self) -> bool:
        """Whether requests may be passed on at all."""
        return self.homes.is_shared

    def is_elsewhere(self, bus: str) -> bool:
        """Whether another server is the home of a bus; one without a home is shown by every server."""
        homes = self.homes
        return homes.is_shared and homes.of(bus).server not in ("", homes.server) and not homes.is_here(bus)

    def elsewhere(self) -> list[Home]:
        """The homes of the buses that other servers show."""
        return [self.homes.of(bus) for bus in self.buses if self.is_elsewhere(bus)]

    @property
    def is_clock_known(self) -> bool:
        """Whether this server knows how its clock and that of the store differ."""
        return self.clock.is_known(self.monotonic())

    def seal(self, scope: Scope, target: bytes) -> str:
        """The header of a request that is passed on."""
        now = self.monotonic()
        hop = Hop(
            sender=self.homes.server,
            arrived_at=float(self.clock.to_store(scope["state"].get(ARRIVED_AT, now))),
            sent_at=float(self.clock.to_store(now)),
            client=scope["client"][0] if scope.get("client") else "",
            scheme="https" if scope["scheme"] in ("https", "wss") else "http",
            host=dict(scope["headers"]).get(b"host", b"").decode("latin-1")[:300],
        )
        return sealed(hop, self._secret, scope.get("method", "GET"), target)

    def open(self, value: str, scope: Scope, target: bytes) -> Hop:
        """The hop of a request that another server has passed on. Raises ForgedHopError."""
        now = self.clock.to_store(self.monotonic())
        return opened(value, self._secret, scope.get("method", "GET"), target, now)


def target_of(scope: Scope) -> bytes:
    """The path and query of a request as they were sent."""
    path: bytes = scope.get("raw_path") or scope["path"].encode()
    query: bytes = scope["query_string"]
    return path.partition(b"?")[0] + (b"?" + query if query else b"")

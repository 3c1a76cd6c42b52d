"""Which server is the home of each bus, as this one knows it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import structlog

from app.home.lease import HomeRow, Lease
from bus.instants import MonotonicClock, UnixTime, monotonic_now
from bus.messages import Message

MAX_EPOCHS_MISSED = 1_000_000
"""So many more a worker can have seen than a store that was restored; more was made up."""
OUTNUMBER_WITHIN_S = 3.0
log = structlog.get_logger()

HomeSubscriber = Callable[[str], None]


class Home(NamedTuple):
    """The home of a bus. ``server``: its id, empty where none is known; ``url``: how others reach it;
    ``until``: on the store's clock, infinite where it has no lease."""

    bus: str
    server: str = ""
    url: str = ""
    epoch: int = 0
    until: UnixTime = UnixTime(0.0)

    @property
    def label(self) -> str:
        """The bus and the server, for a list."""
        return f"{self.bus} ({self.server})"


class BusHome:
    """The home of one bus, as what belongs to the bus sees it."""

    def __init__(self, homes: Homes, bus: str) -> None:
        self._homes = homes
        self._bus = bus

    @property
    def is_here(self) -> bool:
        """Whether this server is the home at this moment."""
        return self._homes.is_here(self._bus)

    @property
    def epoch(self) -> int:
        """Its epoch where it is here, else 0."""
        return self._homes.epoch(self._bus)

    @property
    def left_s(self) -> float:
        """For how long it is here without another renewal; infinite without a lease."""
        return self._homes.left_s(self._bus)

    @property
    def url(self) -> str:
        """How the home is reached; empty where none is known."""
        return self._homes.of(self._bus).url

    async def outnumber(self, epoch: int) -> bool:
        """A worker has seen ``epoch``, higher than that of this home: the store was restored, or its row was
        edited. Have a higher one; False where that cannot be."""
        return await self._homes.outnumber(self._bus, epoch)


class Homes:
    """The home of each bus; the bus ``""`` is what one server does for the site.

    ``is_shared`` False: this server alone uses the store and is the home of everything, without a lease.
    """

    def __init__(
        self, server: str, url: str, *, is_shared: bool, monotonic: MonotonicClock = monotonic_now
    ) -> None:
        self.server = server
        self.url = url
        self.is_shared = is_shared
        self._monotonic = monotonic
        self._homes: dict[str, Home] = {}
        self._held: dict[str, Lease] = {}
        self._subscribers: list[HomeSubscriber] = []
        self.faults: tuple[Message, ...] = ()
        """What a person must put right, as of the last look at the store; the pages of the line and of trends
        show it."""
        self.outnumbered: dict[str, int] = {}
        """The highest epoch that a worker has seen of a bus, where it is above that of its home here."""
        self.is_outnumbered = asyncio.Event()
        self._renumbered = asyncio.Event()

    def of(self, bus: str) -> Home:
        """The home of a bus, as the store had it a second ago."""
        return self._homes.get(bus) or Home(bus)

    def is_here(self, bus: str) -> bool:
        """Whether this server is the home of a bus at this moment, by its own monotonic clock."""
        return self.left_s(bus) > 0.0

    def epoch(self, bus: str) -> int:
        """The epoch of the home of a bus where it is here, else 0."""
        held = self._held.get(bus)
        return held.epoch if held is not None and self.is_here(bus) else 0

    def left_s(self, bus: str) -> float:
        """For how many seconds this server is still the home of a bus without another renewal: infinite
        without a lease, 0 or less where it is not."""
        if not self.is_shared:
            return math.inf
        held = self._held.get(bus)
        return 0.0 if held is None else held.left_s(self._monotonic())

    def subscribe(self, subscriber: HomeSubscriber) -> Callable[[], None]:
        """Call ``subscriber`` with a bus whose home is another one, or is here or no longer; return what
        ends it."""
        self._subscribers.append(subscriber)
        return lambda: self._subscribers.remove(subscriber)

    async def outnumber(self, bus: str, epoch: int) -> bool:
        """Have a higher epoch than ``epoch`` at the home of a bus, soon; False where that cannot be: it is
        not here, or no server can have had so many more."""
        if not self.is_here(bus) or epoch > self.epoch(bus) + MAX_EPOCHS_MISSED:
            return False
        self.outnumbered[bus] = max(epoch, self.outnumbered.get(bus, 0))
        self.is_outnumbered.set()
        try:
            async with asyncio.timeout(OUTNUMBER_WITHIN_S):
                while self.epoch(bus) <= epoch:
                    self._renumbered.clear()
                    await self._renumbered.wait()
        except TimeoutError:
            return False
        return True

    # --- what the service notes ----------------------------------------------------------------

    def note_rows(self, rows: Mapping[str, HomeRow]) -> None:
        """The rows of the store as they are now."""
        former, until = self._homes, math.inf
        self._homes = {
            bus: Home(bus, row.holder, row.url, row.epoch, row.until if self.is_shared else UnixTime(until))
            for bus, row in rows.items()
        }
        buses = former.keys() | self._homes.keys()
        self._publish(bus for bus in buses if _who(former.get(bus)) != _who(self._homes.get(bus)))

    def hold(self, bus: str, held: Lease | None) -> None:
        """This server took the lease of a bus, renewed it, or is no longer its home (None)."""
        former = self._held.pop(bus, None)
        if held is not None:
            self._held[bus] = held
        self._renumbered.set()
        if (former and former.epoch) != (held and held.epoch):
            self._publish((bus,))

    def _publish(self, buses: Iterable[str]) -> None:
        for bus in buses:
            for subscriber in tuple(self._subscribers):
                try:
                    subscriber(bus)
                except Exception:
                    log.exception("subscriber of homes failed", bus=bus or "site")


def _who(home: Home | None) -> tuple[str, str, int] | None:
    return None if home is None else (home.server, home.url, home.epoch)

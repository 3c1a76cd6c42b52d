"""Holds the homes of this server: renews each second, takes what it may, and gives up in time."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from typing import NamedTuple

import structlog

from app.audit.log import EventLog
from app.errors import StoreError
from app.home.homes import Homes
from app.home.keeping.life import HomeLife, Ports
from app.home.lease import (
    RENEW_S,
    UNSEEN,
    Claimant,
    HomeRow,
    Lease,
    Sighting,
    Verdict,
    next_free,
    verdict,
)
from app.home.store import Beat, HomeStore
from bus.instants import Monotonic, MonotonicClock, monotonic_now
from bus.messages import Message

BEAT_WITHIN_S = 2.0
"""A store that takes longer is away."""
LOOK_S = 0.2
"""How often it is looked whether a lease has run out."""
MAX_END_S = 3.0
"""What the end of the server waits for its homes to be given up."""

log = structlog.get_logger()

HomeLifetime = Callable[[], AbstractAsyncContextManager[None]]


class HomeTerms(NamedTuple):
    """What the configuration states of a bus. ``permitted``: this server may be its home; ``automatic``: it
    is taken over without a person, and therefore given up where the lease cannot be renewed."""

    permitted: bool
    automatic: bool


class _Renewal(NamedTuple):
    """One that the store is carrying out; ``epochs``: what is renewed, by bus."""

    began: Monotonic
    epochs: Mapping[str, int]
    task: asyncio.Task[Beat]


class HomeKeeper:
    """Runs the lifespan of each bus whose home is here."""

    def __init__(
        self,
        homes: Homes,
        store: HomeStore,
        events: EventLog,
        terms: Mapping[str, HomeTerms],
        lifetimes: Mapping[str, HomeLifetime],
        ports: Ports,
        *,
        monotonic: MonotonicClock = monotonic_now,
    ) -> None:
        self._homes = homes
        self._store = store
        self._events = events
        self._terms = terms
        self._monotonic = monotonic
        self.instance = secrets.token_hex(8)
        self._sightings = dict.fromkeys(terms, UNSEEN)
        self._lives = {bus: HomeLife(bus, lifetimes[bus], ports) for bus in terms}
        self._leases: dict[str, Lease] = {}
        """Those that are renewed: also those being given up, until its port is closed."""
        self._lapsed: dict[str, Lease] = {}
        """Those that are lost, until its port is closed, too."""
        self._under_way: _Renewal | None = None
        self._records: set[asyncio.Task[None]] = set()
        """Events that are being written."""
        self._wake = asyncio.Event()
        self._all_released = asyncio.Event()
        self._away = ""

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Be the home of buses. Raises StartError where this server alone has the store and a part of a bus
        cannot start."""
        run = self._leased if self._homes.is_shared else self._alone
        renumbering = asyncio.create_task(self._renumber_without_end())
        try:
            async with run():
                yield
        finally:
            renumbering.cancel()

    @asynccontextmanager
    async def _alone(self) -> AsyncIterator[None]:
        beat = await self._store.take_all(self._homes.server, self.instance, self._homes.url, self._terms)
        self._leases = {bus: Lease(row.epoch, self._monotonic()) for bus, row in beat.rows.items()}
        for bus, lease in self._leases.items():
            self._homes.hold(bus, lease)
        self._homes.note_rows(beat.rows)
        async with AsyncExitStack() as stack:
            for life in self._lives.values():
                await stack.enter_async_context(life.running())
            yield

    @asynccontextmanager
    async def _leased(self) -> AsyncIterator[None]:
        lives = [asyncio.create_task(self._live(bus)) for bus in self._terms]
        self._store.listen(self._wake.set)
        await self.beat()
        works = (self._beat_without_end, self._watch)
        tasks = [asyncio.create_task(work()) for work in works]
        try:
            # The buses that are free at the start are loaded before anything is served.
            await asyncio.gather(*(self._lives[bus].settled.wait() for bus in tuple(self._leases)))
            yield
        finally:
            # The leases are renewed until their ports are closed, but none is taken.
            self._all_released = asyncio.Event()
            self._note_released()
            self._terms = {bus: HomeTerms(False, terms.automatic) for bus, terms in self._terms.items()}
            for bus in tuple(self._leases):
                self._give_up(bus)
            await self._released()
            for task in (*tasks, *lives):
                task.cancel()
            await asyncio.gather(*tasks, *lives, return_exceptions=True)
            left = {*self._records, *(() if self._under_way is None else (self._under_way.task,))}
            if left:
                await asyncio.wait(left, timeout=BEAT_WITHIN_S)

    async def _released(self) -> None:
        """Wait until every home is given up, or for `MAX_END_S`."""
        try:
            async with asyncio.timeout(MAX_END_S):
                await self._all_released.wait()
        except TimeoutError:
            log.warning("homes not given up in time", buses=sorted(self._leases))

    def _note_released(self) -> None:
        if not self._leases:
            self._all_released.set()

    # --- the life of one home ------------------------------------------------------------------

    async def _live(self, bus: str) -> None:
        life = self._lives[bus]
        while True:
            await life.held.wait()
            failed = await life.live()
            lease = self._leases.get(bus) or self._lapsed.pop(bus, None)
            self._homes.hold(bus, None)
            if lease is not None:
                # Also one that was lost: its row would keep the bus from every server for its full time,
                # which a renewal that was under way may have started again.
                await self._release(bus, lease)
                self._leases.pop(bus, None)
                self._note_released()
            if failed is not None:
                log.error("home not started", bus=bus or "site", why=failed)
                # Another server may be able to.
                await asyncio.sleep(2 * RENEW_S)
            life.is_on = False
            self._wake.set()

    async def _release(self, bus: str, lease: Lease) -> None:
        try:
            async with asyncio.timeout(BEAT_WITHIN_S):
                await self._store.release(bus, self.instance, lease.epoch)
        except (StoreError, TimeoutError) as error:
            log.warning("home not released; it lapses", bus=bus or "site", why=str(error) or "no response")

    def _give_up(self, bus: str) -> None:
        """End what runs for a bus, its port first. The lease is renewed until then."""
        self._homes.hold(bus, None)
        self._lives[bus].lose()

    def _lose(self, bus: str, why: Message) -> None:
        """The lease is gone."""
        lease = self._leases.pop(bus, None)
        self._give_up(bus)
        if lease is not None:
            self._lapsed[bus] = lease
            log.error("home lost", bus=bus or "site", epoch=lease.epoch, why=str(why))
            self._record("event_home_lost" if bus else "event_home_site_lost", bus, lease.epoch, "", why)

    # --- the epoch -----------------------------------------------------------------------------

    async def _renumber_without_end(self) -> None:
        """Raise the epoch where a worker has seen a higher one than this home has."""
        homes = self._homes
        while True:
            await homes.is_outnumbered.wait()
            homes.is_outnumbered.clear()
            for bus, seen in tuple(homes.outnumbered.items()):
                del homes.outnumbered[bus]
                try:
                    await self._renumber(bus, seen)
                except StoreError as error:
                    log.warning("epoch not raised", bus=bus, why=str(error))

    async def _renumber(self, bus: str, seen: int) -> None:
        lease = self._leases.get(bus)
        if lease is None or lease.epoch > seen:
            return
        epoch = await self._store.renumber(bus, self.instance, lease.epoch, seen)
        if epoch and self._leases.get(bus, lease).epoch == lease.epoch and self._homes.is_here(bus):
            self._leases[bus] = renumbered = Lease(epoch, self._leases.get(bus, lease).confirmed)
            self._homes.hold(bus, renumbered)
            log.warning("epoch raised above that of the worker", bus=bus, seen=seen, epoch=epoch)

    # --- looking at the store ------------------------------------------------------------------

    async def _beat_without_end(self) -> None:
        while True:
            began = self._monotonic()
            self._wake.clear()
            try:
                await self.beat()
            except Exception:
                log.exception("homes were not renewed")
            of_others = (seen for bus, seen in self._sightings.items() if bus not in self._leases)
            now = self._monotonic()
            # A store that is back just before the lease runs out must not be found a second later.
            again = LOOK_S if self._away else RENEW_S
            try:
                async with asyncio.timeout(max(min(began + again, next_free(of_others, now)) - now, 0.0)):
                    await self._wake.wait()
            except TimeoutError:
                continue

    async def beat(self) -> None:
        """Renew what is held, see the rows of all, and take what may be taken."""
        looked = self._monotonic()
        if self._under_way is None:
            held = {bus: lease.epoch for bus, lease in self._leases.items()}
            renewal = self._store.beat(self._homes.server, self.instance, self._homes.url, held)
            self._under_way = _Renewal(looked, held, asyncio.create_task(renewal))
        # One at a time: a store that does not respond must not find many of them when it does.
        began, epochs, task = self._under_way
        await asyncio.wait({task}, timeout=BEAT_WITHIN_S)
        if not task.done():
            self._store_is_away(looked, "it does not respond")
            return
        self._under_way = None
        try:
            beat = task.result()
        except StoreError as error:
            self._store_is_away(looked, str(error))
            return
        self._away = ""
        self._see(beat, began, epochs)
        # What belongs to a bus could not be loaded: another server may be able to.
        if not self._store.is_away:
            await self._take_free(beat)

    def _store_is_away(self, began: Monotonic, why: str) -> None:
        """What no other server takes without a person stays; all else is lost by its own clock."""
        if why != self._away:
            log.error("homes cannot be renewed", why=why)
        self._away = why
        for bus, lease in tuple(self._leases.items()):
            if not self._terms[bus].automatic:
                self._renewed(bus, lease.renewed(began))

    def _renewed(self, bus: str, lease: Lease) -> None:
        """Also where it had run out by the own clock, and this comes before that was looked at."""
        self._leases[bus] = lease
        if self._lives[bus].held.is_set():
            self._homes.hold(bus, lease)

    def _see(self, beat: Beat, began: Monotonic, epochs: Mapping[str, int]) -> None:
        now = self._monotonic()
        self._homes.note_rows(beat.rows)
        for bus in self._terms:
            row = beat.rows.get(bus)
            self._sightings[bus] = self._sightings[bus].again(row, now, beat.highest.get(bus, 0))
            lease = self._leases.get(bus)
            if lease is None or lease.epoch != epochs.get(bus):
                continue
            if row is None or not self._is_mine(row, lease):
                self._lose(bus, Message("home_reason_changed"))
                continue
            self._renewed(bus, lease.renewed(began))
            if row.request(beat.now) not in ("", self._homes.server):
                self._give_up(bus)

    def _is_mine(self, row: HomeRow, lease: Lease) -> bool:
        mine = (self._homes.server, self.instance, lease.epoch)
        return (row.holder, row.instance, row.epoch) == mine and not row.is_released

    async def _watch(self) -> None:
        """Give up what could not be renewed, also while the store does not respond."""
        while True:
            await asyncio.sleep(LOOK_S)
            self.look()

    def look(self) -> None:
        """Give up each lease that has run out by the own clock."""
        now = self._monotonic()
        for bus, lease in tuple(self._leases.items()):
            if lease.left_s(now) <= 0.0:
                self._lose(bus, Message.of("home_reason_lapse", why=self._away or "-"))

    # --- taking --------------------------------------------------------------------------------

    async def _take_free(self, beat: Beat) -> None:
        found: dict[str, Verdict] = {}
        for bus, terms in self._terms.items():
            if bus in self._leases or self._lives[bus].is_on:
                continue
            sighting = self._sightings[bus]
            claimant = Claimant(self._homes.server, self.instance, *terms)
            found[bus] = verdict(sighting, claimant, self._monotonic(), beat.now)
            if found[bus] == "may_take":
                await self._take(bus, sighting, claimant)
        self._note_faults(found, beat)

    async def _take(self, bus: str, sighting: Sighting, claimant: Claimant) -> None:
        began, former = self._monotonic(), self._homes.of(bus)
        reason = _reason(sighting.row)
        try:
            taken = await self._store.take(
                sighting,
                claimant,
                bus,
                url=self._homes.url,
                epoch_above=former.epoch,
                reason=str(reason),
                within_s=BEAT_WITHIN_S,
            )
        except (StoreError, TimeoutError) as error:
            log.warning("home not taken", bus=bus or "site", why=str(error) or "no response")
            return
        if not isinstance(taken, HomeRow):
            return
        lease = self._leases[bus] = Lease(taken.epoch, began)
        self._sightings[bus] = self._sightings[bus].again(taken, self._monotonic(), taken.epoch)
        self._homes.hold(bus, lease)
        self._lives[bus].hold()
        log.info("home taken", bus=bus or "site", epoch=taken.epoch, why=taken.reason)
        by_person = taken.reason != str(reason)
        why = taken.reason if by_person else reason
        code = "event_home_taken" if bus else "event_home_site_taken"
        self._record(code, bus, taken.epoch, taken.requested_by if by_person else "", why)

    def _record(self, code: str, bus: str, epoch: int, who: str, why: str | Message) -> None:
        """Write the event of a home; the renewals do not wait for it."""
        task = asyncio.create_task(self._write_event(code, bus, epoch, who, why))
        self._records.add(task)
        task.add_done_callback(self._records.discard)

    async def _write_event(self, code: str, bus: str, epoch: int, who: str, why: str | Message) -> None:
        event = Message.of(code, server=self._homes.server, epoch=epoch)
        try:
            await self._events.record(kind="home", who=who, bus=bus or None, what=event, message=why)
        except StoreError as error:
            log.warning("event of a home not recorded", what=str(event), why=str(error))

    def _note_faults(self, found: Mapping[str, Verdict], beat: Beat) -> None:
        """What a person must put right: it is logged once, and shown on pages."""
        server, rows = self._homes.server, beat.rows
        twins = [bus for bus, each in found.items() if each == "held_by_namesake" and self._lives_on(bus)]
        faults = []
        if twins:
            buses, url = ", ".join(bus or "site" for bus in twins), rows[twins[0]].url
            faults.append(Message.of("home_namesake", server=server, buses=buses, url=url))
        for bus, each in found.items():
            if each == "unusable":
                faults.append(Message.of("home_row_unusable", bus=bus or "site", epoch=rows[bus].epoch))
        for fault in faults:
            if fault not in self._homes.faults:
                log.error("home", why=str(fault))
        self._homes.faults = tuple(faults)

    def _lives_on(self, bus: str) -> bool:
        """Whether the row was renewed since this process looks: else it is of its former run."""
        return self._sightings[bus].changes > 1


def _reason(row: HomeRow | None) -> Message:
    """Why a bus is free."""
    if row is None:
        return Message("home_reason_first")
    if row.is_released:
        return Message.of("home_reason_released", holder=row.holder)
    return Message.of("home_reason_lapsed", holder=row.holder, seconds=5)

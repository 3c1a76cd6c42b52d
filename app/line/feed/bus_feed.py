"""The feed of one bus: its worker, when another worker may replace it, and until when its readings have
arrived; and the units that may hold a staged speed when the worker is replaced.

Commands are verified by what a worker reports, so a bus goes to another worker only once the former one is
provably gone: it announced its end, or its connection ended and it did not return in time. A worker that
merely stalls (suspended, starved, behind a cut network) keeps its bus for longer.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Collection, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from enum import Enum
from math import inf
from typing import Protocol

import structlog

from app.core.database import Database, StoreConnection
from app.errors import StoreError
from app.line.feed.channel import Channel, MessageSink
from app.line.feed.ingest import FeedQuota, Ingest, IngestPosition
from app.line.feed.plausibility import Coverage
from app.line.live.bus_live import NO_WORKER, Audience, BusLive, held_units
from app.line.pipeline import OTHER_RELEASE, Pipeline
from app.version import VERSION
from bus.contract import CONTRACT_VERSION, Hello, MalformedMessageError, Staged, Update, Welcome
from bus.instants import Monotonic, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message


class Ending(Enum):
    """The end of a worker's connection. The value: seconds for which its bus is kept for it."""

    LEFT = 0.0
    """The worker announced its end."""
    LOST = 5.0
    """The other side ended the connection: a worker that still runs is back within 3 s."""
    CUT = 60.0
    """This side ended the connection, because nothing came: the worker may still run, and resume."""


@dataclass(frozen=True, slots=True)
class Credential:
    """The token, the bus and the address with which a worker connected. ``own``: it is the child of this
    server."""

    token: str
    bus: str
    address: str
    own: bool = False

    def __str__(self) -> str:
        return f"{self.token} ({self.address})" if self.address else self.token


@dataclass(slots=True)
class Holder:
    """The worker that has a bus, connected or expected back. ``port_seen``: its port has been open."""

    worker: str
    credential: Credential
    port_seen: bool = False
    free_at: Monotonic = Monotonic(inf)

    def connection_ended(self, ending: Ending, now: Monotonic) -> None:
        """Keep the bus for its worker for the time that ``ending`` allows."""
        self.free_at = now + ending.value

    def is_same(self, worker: str, credential: Credential) -> bool:
        """Return whether a worker that connects is the same process as before."""
        return self.worker == worker and self.credential.token == credential.token

    def yields_to(self, worker: str, credential: Credential, now: Monotonic) -> bool:
        """Return whether the bus goes to this worker: to the same one always, to another if the holder is
        gone."""
        if self.is_same(worker, credential) or now >= self.free_at:
            return True
        if credential.own:
            # Only one process has the token of a child, and its next one starts after its end.
            return self.credential.own and self.free_at < Monotonic(inf)
        # It is the child of a bus whose port is on another machine: the worker there must get the bus.
        return self.credential.own and not self.port_seen


def refusal(hello: Hello, credential: Credential, buses: Collection[str]) -> Message | None:
    """Return why this worker gets no bus, or None if it gets one. ``buses``: those of the configuration."""
    if hello.version != CONTRACT_VERSION:
        versions = {"version": hello.version, "needed": CONTRACT_VERSION}
        return Message.of(OTHER_RELEASE, of_worker=hello.software, release=VERSION, **versions)
    if hello.bus != credential.bus:
        return Message.of("worker_token_of_other_bus", bus=credential.bus)
    if hello.bus not in buses:
        return Message.of("worker_bus_unknown", bus=hello.bus, known=", ".join(buses) or "-")
    return None


_log = structlog.get_logger()

HELD = Message("worker_bus_held")
TIMED_OUT = Message("worker_silent")
MALFORMED = Message("worker_malformed")
REPLACED = "another worker connected for this bus"
TICK_S = 1.0
TIMEOUT_TICKS = 5
"""The ticks without a report after which a worker is gone or stuck; it reports its figures every second.
Ticks are counted, not seconds, so that a stall of the app does not count as a stall of the worker."""


class WorkerLeft(ConnectionError):
    """Raised when the worker announced that it leaves."""


class WorkerTimeout(ConnectionError):
    """Raised when nothing came from the worker for too long."""


class WorkerConnection(MessageSink, Protocol):
    """The WebSocket of a worker as this package uses it."""

    async def receive(self) -> bytes:
        """Return the next message. Raise ConnectionError at the end (WorkerLeft if that was announced),
        MalformedMessageError for text."""

    def admit(self) -> None:
        """Accept the large messages that follow Hello."""

    async def close(self, reason: str) -> None:
        """End the connection, with a reason in words. Raise nothing."""


@dataclass(eq=False, repr=False)
class BusFeed:
    """The feed of one bus. ``monotonic`` measures how long a bus is kept for a worker that may return."""

    _channel: Channel
    _pipeline: Pipeline
    _held: HeldSpeeds
    monotonic: MonotonicClock = monotonic_now
    timeout_ticks: int = TIMEOUT_TICKS
    coverage: Coverage = field(default_factory=Coverage)
    _quota: FeedQuota = field(default_factory=FeedQuota)
    _received: IngestPosition = field(default_factory=lambda: IngestPosition(""))
    _holder: Holder | None = None
    _connection: WorkerConnection | None = None
    _watches: set[asyncio.Task[None]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._began = self.monotonic()

    async def load(self, newest: Awaitable[UnixTime | None]) -> None:
        """Note until when the last run of the server followed the bus: the time of its newest stored
        reading."""
        self.coverage.until = await newest

    @property
    def has_own_worker(self) -> bool:
        """Whether a worker is linked that is the child of this server."""
        return self._connection is not None and self._holder is not None and self._holder.credential.own

    def watch(self, units: list[int], trace: bool) -> None:
        """Send the worker the units that are on an open page, and whether its trace is followed."""
        watch = asyncio.create_task(self._channel.watch(units, trace=trace))
        self._watches.add(watch)
        watch.add_done_callback(self._watches.discard)

    async def serve(
        self,
        hello: Hello,
        connection: WorkerConnection,
        credential: Credential,
        refused: Message | None = None,
    ) -> None:
        """Serve a worker to its end, or send it away if it is ``refused`` or another has the bus. Raise
        ConnectionError if it is gone before it was admitted."""
        holder = self._holder
        if refused is None and holder is not None:
            is_free = holder.yields_to(hello.worker, credential, self.monotonic())
            refused = None if is_free else HELD
        if refused is not None:
            held_by = "" if holder is None else str(holder.credential)
            self._pipeline.worker_refused(unix_now(), held_by, str(credential), refused)
            await send_away(connection, refused, unix_now())
            return
        # This happens in the same turn of the loop: of two concurrent hellos the second meets the first.
        former = self._take(hello, connection, credential)
        try:
            await self._serve_holder(hello, connection, former)
        finally:
            self._release(connection, NO_WORKER, Ending.LOST)

    def _take(
        self, hello: Hello, connection: WorkerConnection, credential: Credential
    ) -> WorkerConnection | None:
        """Give the bus to this worker; return the connection that had it until now, if still open."""
        again = self._holder is not None and self._received.worker == hello.worker
        if not again:
            self._received = IngestPosition(hello.worker)
        self._holder = Holder(hello.worker, credential)
        former, self._connection = self._connection, connection
        if former is not None:
            self._channel.closed(former)
        # After a restart of the server alone, the worker of another computer connects again.
        ran_before = not credential.own and hello.sent_at - hello.started_at > self.monotonic() - self._began
        self._pipeline.worker_connected(hello, unix_now(), again=again or ran_before)
        return former

    async def _serve_holder(
        self, hello: Hello, connection: WorkerConnection, former: WorkerConnection | None
    ) -> None:
        if former is not None:
            await former.close(REPLACED)
        connection.admit()
        try:
            held = self._held.units
            await connection.send(Welcome(CONTRACT_VERSION, self._received.seq, unix_now(), held=held))
            await self._follow(hello, connection)
        except MalformedMessageError as error:
            _log.warning("bus worker sent a malformed message", bus=hello.bus, why=str(error))
            self._release(connection, MALFORMED, Ending.LOST)
            await connection.close(str(error))
        except WorkerTimeout:
            self._release(connection, TIMED_OUT, Ending.CUT)
            await connection.close(str(TIMED_OUT))
        except WorkerLeft:
            self._release(connection, NO_WORKER, Ending.LEFT)

    async def _follow(self, hello: Hello, connection: WorkerConnection) -> None:
        channel, pipeline, quota = self._channel, self._pipeline, self._quota
        ingest = Ingest(
            hello,
            self._received,
            channel,
            pipeline,
            connection,
            quota,
            self.coverage,
            unix_now,
        )
        works = (self._receive(ingest, connection), self._tick(ingest))
        tasks = {asyncio.create_task(work) for work in works}
        try:
            ended, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in ended:
                task.result()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _receive(self, ingest: Ingest, connection: WorkerConnection) -> None:
        while self._connection is connection:
            await ingest.receive(await connection.receive())
            if self._holder is not None:
                self._holder.port_seen |= self._pipeline.port_is_open

    async def _tick(self, ingest: Ingest) -> None:
        while ingest.missed_ticks < self.timeout_ticks:
            await ingest.tick()
            await asyncio.sleep(TICK_S)
        raise WorkerTimeout(str(TIMED_OUT))

    def _release(self, connection: WorkerConnection, cause: Message, ending: Ending) -> None:
        """Note that this connection has ended, unless it was released already or another has replaced it."""
        self._channel.closed(connection)
        if self._connection is connection and self._holder is not None:
            self._connection = None
            self._holder.connection_ended(ending, self.monotonic())
            self._pipeline.worker_disconnected(unix_now(), cause)


STORE_AGAIN_S = 1.0


@dataclass(eq=False)
class HeldSpeeds:
    """The record of which units of a bus may hold a staged speed. No request reads one back (82h), only the
    worker that staged it knows, and the next broadcast (83h) would execute it."""

    _live: BusLive
    _database: Database
    _under_way: Counter[int] = field(default_factory=Counter)
    """The number of commands under way that stage a speed in each unit."""
    _removed: set[int] = field(default_factory=set)
    """The units that may hold a staged speed and are not configured any more, but may still be on the bus."""
    _stored: set[int] = field(default_factory=set)
    _storing: asyncio.Lock = field(default_factory=asyncio.Lock)
    _changed: asyncio.Event = field(default_factory=asyncio.Event)

    async def load(self) -> None:
        """Show the units that held one when the server ended as unknown, until their worker reports."""
        query, bus = "SELECT unit FROM held_speed WHERE bus = ?", (self._live.settings.name,)
        rows = await self._database.read(lambda connection: connection.execute(query, bus).fetchall())
        self._stored = {unit for (unit,) in rows}
        self._removed = self._stored - self._live.units.keys()
        self.show_unknown(self._stored)
        self._live.subscribe(Audience.DRIFT, self._note)

    @property
    def units(self) -> list[int]:
        """Return the addresses of the units that may hold a staged speed, as far as the app knows."""
        return sorted({*held_units(self._live), *+self._under_way, *self._removed})

    @asynccontextmanager
    async def staging(self, units: Collection[int]) -> AsyncIterator[None]:
        """Store that ``units`` may hold one before a command stages it, because server and worker may end
        before the response. Raise StoreError, after which nothing may be sent."""
        self._under_way.update(units)
        try:
            await self._store()
            yield
        except BaseException:
            self.show_unknown(units)
            raise
        finally:
            self._under_way.subtract(units)
            self._changed.set()

    def show_unknown(self, units: Collection[int]) -> None:
        """Show that it is not known what ``units`` hold."""
        self._live.apply([Staged(unit, unix_now(), None, unknown=True) for unit in units])

    def _note(self, updates: Sequence[Update]) -> None:
        if any(isinstance(update, Staged) for update in updates):
            self._changed.set()

    async def follow(self) -> None:
        """Store each change, as long as the server runs."""
        while await self._changed.wait():
            self._changed.clear()
            try:
                await self._store()
            except StoreError:
                self._changed.set()
                await asyncio.sleep(STORE_AGAIN_S)

    async def _store(self) -> None:
        async with self._storing:
            held, stored, bus = set(self.units), self._stored, self._live.settings.name
            if held == stored:
                return

            def write(connection: StoreConnection) -> None:
                gone, new = ([(bus, unit) for unit in units] for units in (stored - held, held - stored))
                connection.executemany("DELETE FROM held_speed WHERE bus = ? AND unit = ?", gone)
                connection.executemany("INSERT OR IGNORE INTO held_speed VALUES (?, ?)", new)

            await self._database.write(write)
            self._stored = held


async def send_away(connection: WorkerConnection, reason: Message, now: UnixTime) -> None:
    """Refuse a worker in English words, which a worker of another version can read too."""
    await connection.send(Welcome(CONTRACT_VERSION, 0, now, str(reason)))
    await connection.close(str(reason))

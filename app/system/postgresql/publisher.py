"""The publisher: it copies stored data into the plant's database, at once, or when the database is back.

Nothing waits for it. The threads of readers read the stores, and a thread of its own waits for the database.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import structlog

from app.core.database import Database, StoreConnection
from app.core.lifespan import in_thread
from app.errors import StoreError
from app.line.history.recorder import Tail
from app.line.history.series.runs import MINUTE, micros
from app.line.history.service import History, seconds
from app.line.history.writer import LATE
from app.system.postgresql.destination import Destination
from app.system.postgresql.outbox import (
    SETTLED,
    Cursor,
    HistoryRows,
    add_entries,
    end_of_blocks,
    end_of_logs,
    first_block_since,
    read_cursor,
    read_identity,
    write_cursor,
)
from app.system.postgresql.rows import Batch
from app.system.postgresql.settings import PostgresqlSettings
from bus.instants import Monotonic, UnixTime, monotonic_now, unix_now
from bus.messages import Message, in_english, number
from bus.settings import BusSettings

EVERY_S = 1.0
REST = 4.0
"""The pause after a batch while the publisher is behind, as a multiple of the batch's duration, so that
people and buses come first."""
MAX_REST_S = 2.0
RETRY_S = (1.0, 2.0, 5.0, 10.0, 30.0)
"""The seconds between two attempts; the last value repeats."""
STORE_EVERY_S = 10.0
"""The seconds between storing the cursor. After a crash, later rows are sent again."""
AGAIN = 2 * MINUTE
"""The span sent again after a start: a store from a backup may be older than the cursor, µs."""
KEEP_UP_EVERY_S = 6 * 3600.0
CLOCK_SAID_S = 60.0
"""The difference of the clocks above which there is a notice."""
log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class PublisherStatus:
    """The state of the publisher. ``until``: everything stored up to this time is published; ``fault``: why
    nothing is published now; ``clock_ahead_s``: by how much the database's clock is ahead; ``rows``: the
    number sent since the start; ``last``: when the database last had everything, None if it never had."""

    place: str
    until: UnixTime
    fault: Message | None = None
    clock_ahead_s: float = 0.0
    rows: int = 0
    last: UnixTime | None = None

    def lag_s(self, now: UnixTime) -> float:
        """Return the seconds of data that are not completely published."""
        return max(0.0, float(now - self.until))

    def state(self, now: UnixTime) -> Message:
        """Return a sentence about how current the database is."""
        seconds = number(f"{self.lag_s(now):.0f}")
        if self.fault is not None:
            return Message.of("publisher_lacks", reason=self.fault, seconds=seconds)
        return Message.of("publisher_has", place=self.place, seconds=seconds)

    @property
    def notice(self) -> Message | None:
        """The reason why nothing is published, or that the database's clock differs; usually None."""
        if self.fault is not None:
            return self.fault
        if abs(self.clock_ahead_s) < CLOCK_SAID_S:
            return None
        ahead = number(f"{self.clock_ahead_s:+.0f}")
        return Message.of("publisher_clock", place=self.place, seconds=ahead)


class Publisher:
    """The publisher of a site; after a failure it waits and goes on from its cursor."""

    def __init__(
        self,
        to: PostgresqlSettings,
        site: str,
        buses: Sequence[BusSettings],
        database: Database,
        history: History,
    ) -> None:
        identity = database.read_now(read_identity)
        self._destination = Destination(to, site, identity, buses)
        self._rows = HistoryRows(buses, to.step)
        self._database, self._history = database, history
        self._step = to.step
        self._cursor: Cursor | None = None
        self._stored: Cursor | None = None
        self._store_at = self._keep_up_at = Monotonic(0.0)
        self._shown_until = 0
        self._failures = 0
        self.status = PublisherStatus(to.place, unix_now())

    async def follow(self) -> None:
        """Publish stored data until canceled."""
        try:
            while True:
                wait_s = await self._attempt()
                await asyncio.sleep(wait_s)
        finally:
            self._destination.abandon()

    async def end(self) -> None:
        """Store the cursor as the server ends."""
        if self._cursor is not None and self._cursor != self._stored:
            await self._store(self._cursor)

    async def _attempt(self) -> float:
        """Publish one batch; return the seconds to wait afterwards."""
        began = monotonic_now()
        try:
            is_behind = await self._publish()
        except StoreError as error:
            if self.status.fault != error.message:
                log.warning("not published", why=in_english(error.message))
            self.status = replace(self.status, fault=error.message)
            wait = RETRY_S[min(self._failures, len(RETRY_S) - 1)]
            self._failures += 1
            return wait
        if self.status.fault is not None:
            log.info("published again")
        self._failures = 0
        self.status = replace(self.status, fault=None, clock_ahead_s=self._destination.clock_ahead_s)
        took = monotonic_now() - began
        return min(MAX_REST_S, REST * took) if is_behind else max(0.0, EVERY_S - took)

    async def _publish(self) -> bool:
        """Send the rows after the cursor, up to the limit of a batch; return whether there are more. Raise
        StoreError."""
        before = self._cursor = self._cursor or await self._begin()
        await in_thread(self._destination.connect, stop=self._destination.abandon)
        now, batch = micros(unix_now()), Batch()
        cursor, has_entries = await self._database.read(lambda c: add_entries(c, before, batch))
        read = partial(self._add_readings, cursor=cursor, now=now, batch=batch)
        cursor, has_readings, shown_until = await self._history.read(read)
        self._history.report(self._rows.damaged)
        self._rows.damaged = []
        if has_entries and has_readings:
            cursor = replace(cursor, until=now)
        if batch.size:
            send = partial(self._destination.send, batch, unix_now())
            await in_thread(send, stop=self._destination.abandon)
        self._shown_until = shown_until
        await self._advance(cursor, batch.size)
        return not (has_entries and has_readings)

    def _add_readings(
        self, connection: StoreConnection, tail: Tail, cursor: Cursor, now: int, batch: Batch
    ) -> tuple[Cursor, bool, int]:
        cursor, has_all = self._rows.add_blocks(connection, tail, cursor, batch)
        if not has_all:
            return cursor, False, self._shown_until
        self._rows.add_lost(connection, now - LATE, batch)
        end = now - SETTLED - (now - SETTLED) % (self._step or 1)
        self._rows.add_newest(connection, tail, (self._shown_until or end - AGAIN, end), batch)
        return cursor, True, end

    async def _begin(self) -> Cursor:
        """Return the stored cursor, or one at the end of the stored data: a command fills in the past."""
        stored = await self._database.read(read_cursor)
        if stored is None:
            events, alarms = await self._database.read(end_of_logs)
            blocks = await self._history.read(lambda connection, _: end_of_blocks(connection))
            return Cursor(blocks, events, alarms, micros(unix_now()))
        self._has_everything(stored)
        again = await self._history.read(lambda c, _: first_block_since(c, stored.until - AGAIN))
        return stored if again is None else replace(stored, blocks=min(stored.blocks, again - 1))

    def _has_everything(self, cursor: Cursor) -> None:
        until = seconds(cursor.until)
        self.status = replace(self.status, until=until, last=until)

    async def _advance(self, cursor: Cursor, rows: int) -> None:
        self._cursor = cursor
        self._has_everything(cursor)
        self.status = replace(self.status, rows=self.status.rows + rows)
        if monotonic_now() >= self._store_at:
            self._store_at = monotonic_now() + STORE_EVERY_S
            await self._store(cursor)
        if monotonic_now() >= self._keep_up_at:
            self._keep_up_at = monotonic_now() + KEEP_UP_EVERY_S
            now = unix_now()
            await in_thread(partial(self._destination.keep_up, now), stop=self._destination.abandon)

    async def _store(self, cursor: Cursor) -> None:
        await self._database.write(lambda connection: write_cursor(connection, cursor))
        self._stored = cursor

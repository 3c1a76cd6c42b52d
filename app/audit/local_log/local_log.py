"""The local log of a server: entries of the time without the database, and their way into it."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from itertools import islice

import structlog

from app.audit.events.entry import Event, new_entry
from app.audit.local_log.file import LocalFile
from app.audit.local_log.transaction import LoggedTransaction, ReadLog, new_transaction
from app.audit.local_log.writing import LateEntries, TransactionWriter, forget_old
from app.audit.proof.keys import Keys
from app.database import Database
from app.database.availability import Availability
from app.errors import StoreError, StoreUnavailableError
from bus.errors import LinesideError
from bus.instants import Clock, unix_now
from bus.messages import Message

FORGET_EVERY_S = 6 * 3600.0
log = structlog.get_logger()
FollowedSubscriber = Callable[[Sequence[Event], Sequence[int]], Awaitable[None]]
"""Called with the entries of a transaction and their numbers, once they have followed."""


class LocalLog:
    """Logs transactions in a file while the database is away, and writes them into it in order, each once,
    when it is back."""

    def __init__(
        self,
        database: Database,
        availability: Availability,
        file: LocalFile,
        keys: Keys,
        clock: Clock = unix_now,
    ) -> None:
        self._database = database
        self._availability = availability
        self._file = file
        self._keys = keys
        self.writer = TransactionWriter(keys)
        self._clock = clock
        self._followed: list[FollowedSubscriber] = []
        self._pending: deque[LoggedTransaction] = deque()
        self._adding = asyncio.Lock()
        self._following = asyncio.Lock()
        self._count = 0
        self._gone = 0
        """How many have followed since the start."""
        self._is_noted = False
        availability.before_return = self.follow

    @property
    def is_needed(self) -> bool:
        """Whether the database is away, or has not caught up yet."""
        return self._availability.is_away or self.has_pending

    @property
    def has_pending(self) -> bool:
        """Whether something is not in the database yet."""
        return bool(self._pending) or self._adding.locked()

    def on_followed(self, subscriber: FollowedSubscriber) -> None:
        """Call ``subscriber`` with what has come into the database."""
        self._followed.append(subscriber)

    def refuse(self) -> None:
        """Raises StoreUnavailableError for an entry that is not logged locally."""
        self._availability.refuse_while_away()
        raise StoreUnavailableError(Message("store_catching_up"))

    def since(self, serial: int) -> tuple[list[LoggedTransaction], int]:
        """What was logged after the transaction of a serial number and is still pending, and the number of
        the last one."""
        first, last = max(0, serial - self._gone), self._gone + len(self._pending)
        return list(islice(self._pending, first, None)), last

    def pending(self) -> Iterator[LoggedTransaction]:
        """All that is not in the database yet, oldest first."""
        yield from tuple(self._pending)

    async def load(self) -> None:
        """At start, before anything is written: bring what the last run left into the database. Raises
        StoreError."""
        found = await asyncio.to_thread(self._file.read, self._keys.ring)
        if found.fault is not None:
            await self._refuse(found, found.fault)
            return
        self._pending.extend(found.transactions)
        await self.follow()
        if found.is_cut_off:
            what = Message.of("event_local_log_cut_off", n=len(found.transactions))
            log.warning("local log cut off", what=str(what))
            await self._remark(what)

    async def add(self, transaction: LoggedTransaction, *, is_urgent: bool) -> None:
        """Log a transaction; it is on disk when this returns. Raises StoreError where it is not."""
        # Who waits may be canceled; what is in the file must be pending.
        await asyncio.shield(self._add(transaction, is_urgent))

    async def _add(self, transaction: LoggedTransaction, is_urgent: bool) -> None:
        async with self._adding:
            append = partial(self._file.append, transaction, self._keys.ring, is_urgent=is_urgent)
            await asyncio.to_thread(append)
            self._pending.append(transaction)
            # Pending entries follow when the database is back.
            self._availability.lost(Message("store_catching_up"))

    async def follow(self) -> None:
        """Write all that is pending into the database, in order; nothing is pending when this returns. Raises
        StoreUnavailableError where that is away again."""
        # Two at once would each take an entry off that one of them has not written.
        async with self._following:
            while self.has_pending or not self._is_noted:
                await self._drain()
                await self._note_end()
            self._is_noted = False
            with suppress(StoreError):
                self._file.clear()

    async def forget(self) -> None:
        """Run until canceled: forget the references that no local log needs any more."""
        while True:
            await asyncio.sleep(FORGET_EVERY_S)
            await self._database.write(partial(forget_old, now=self._clock()))

    async def _drain(self) -> None:
        while self.has_pending:
            if not self._pending:
                await asyncio.sleep(0)
                continue
            transaction = self._pending[0]
            written = await self._write(transaction)
            self._pending.popleft()
            self._gone += 1
            self._count += 1
            for subscriber in self._followed:
                await subscriber(*written)

    async def _write(self, transaction: LoggedTransaction) -> LateEntries:
        now = self._clock()
        try:
            return await self._database.attempt(
                lambda connection: self.writer.write_late(connection, transaction, now)
            )
        except StoreUnavailableError:
            raise
        except (LinesideError, LookupError, TypeError, ValueError) as error:
            # It must not keep those behind it from following.
            log.exception("a local entry does not follow", ref=transaction.ref)
            what = Message.of("event_local_log_entry_left", ref=transaction.ref)
            await self._remark(what, str(error), ref=transaction.ref)
            return [], []

    async def _note_end(self) -> None:
        """Everything has followed: the audit log states it. Also where nothing was pending, the database is
        written: one that can only be read is not back."""
        count, now = self._count, self._clock()
        await self._database.attempt(lambda connection: forget_old(connection, now))
        if count:
            what = Message.of("event_local_log_followed", n=count)
            await self._remark(what, Message.of("store_away_for", seconds=self._away_s()))
        self._count -= count
        self._is_noted = True

    def _away_s(self) -> int:
        since = self._availability.away_since
        return 0 if since is None else max(0, round(self._clock() - since))

    async def _refuse(self, found: ReadLog, fault: Message) -> None:
        """A local log that was altered, or is of another site, is kept as evidence; what comes before the
        fault is genuine and follows."""
        aside = await asyncio.to_thread(self._file.put_aside, self._clock())
        log.error("local log not believed", why=str(fault), file=str(aside))
        self._pending.extend(found.transactions)
        await self.follow()
        what = Message.of("event_local_log_refused", n=len(found.transactions), file=aside.name)
        await self._remark(what, fault)

    async def _remark(self, what: Message, message: str | Message = "", ref: str = "") -> None:
        now = self._clock()
        entry = new_entry(time=now, kind="audit", what=what, message=message)
        noted = new_transaction(now, [entry])
        if ref:
            noted = LoggedTransaction(ref, now, [entry])
        await self._database.attempt(lambda connection: self.writer.write_noted(connection, noted))

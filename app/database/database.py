"""One store, of whatever engine: one thread writes, others read."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from app.database.availability import Availability, in_time
from app.database.migration import Migration
from app.database.store_connection import StoreConnection
from app.errors import StoreError
from bus.messages import Message

T = TypeVar("T")
Work = Callable[[StoreConnection], T]
Listener = Callable[[str], None]
READERS = 4
COSTLY_READERS = 2
COSTLY_S = 3.0
"""What one costly read may take: on SQLite CPU time of its thread, on PostgreSQL time of each statement."""


class Database(ABC):
    """One store. Opening brings it up to date and raises StoreError in words when it cannot be used."""

    name: str
    """Names the store in messages: its path, or its URL without what is secret, and its schema."""
    file: Path | None
    """Where the store is a file of this machine."""
    migrated: list[Migration]
    """The steps that opening took."""
    availability: Availability | None = None
    """Where another machine has the store: whether it responds."""

    def __init__(self, name: str, label: str) -> None:
        self.name = name
        self._writer = ThreadPoolExecutor(1, thread_name_prefix=f"{label}-writer")
        self._readers = ThreadPoolExecutor(READERS, thread_name_prefix=f"{label}-reader")
        self._costly = ThreadPoolExecutor(COSTLY_READERS, thread_name_prefix=f"{label}-costly")
        self._brief = self._writer
        """Where an engine lets more than one transaction write, a thread apart from the writer's."""

    async def write(self, work: Work[T]) -> T:
        """Run ``work`` in one transaction on the writer's thread; it is on disk when this returns."""
        return await self._run(self._writer, self.write_now, work)

    async def read(self, work: Work[T]) -> T:
        """Run ``work`` on a read-only connection in a thread."""
        return await self._run(self._readers, self.read_now, work)

    async def read_costly(self, work: Work[T]) -> T:
        """Run a read that may take long, apart from all others. Raises TooCostlyError after `COSTLY_S`."""
        return await self._run(self._costly, self._read_within, work)

    async def attempt(self, work: Work[T]) -> T:
        """Run ``work`` in one transaction also while the database is known to be away. Raises
        StoreUnavailableError where it takes too long; it may still be stored."""
        return await in_time(self._begin(self._writer, self.write_now, work))

    async def write_briefly(self, work: Work[T]) -> T:
        """Run ``work``, a few trivial statements, in one transaction that keeps no other waiting for longer
        than a second, also while the database is known to be away. Raises StoreUnavailableError where it
        takes too long; it may still be stored."""
        return await in_time(self._begin(self._brief, self.write_briefly_now, work))

    def write_briefly_now(self, work: Work[T]) -> T:
        """The same on this thread: the command line's."""
        return self.write_now(work)

    def probe(self) -> asyncio.Future[object]:
        """Begin a trivial read, also while the database is known to be away."""
        return self._begin(self._readers, self.read_now, _look)

    @abstractmethod
    def interrupt(self) -> None:
        """End every wait for a database that does not respond, of all stores. For the end of the server."""

    @abstractmethod
    def write_now(self, work: Work[T]) -> T:
        """Run ``work`` in one transaction on this thread: the command line's, or the writer's own."""

    @abstractmethod
    def read_now(self, work: Work[T]) -> T:
        """Run ``work`` on a read-only connection of this thread."""

    @abstractmethod
    def listen(self, channel: str, callback: Listener) -> None:
        """Call ``callback`` on the running event loop with each text that a committed transaction of any
        server notified. An empty text: the connection was lost and is back; what was notified meanwhile is
        not known."""

    @abstractmethod
    def give_back(self, pages: int) -> None:
        """Return so many pages of deleted rows to the disk. For the writer's own thread."""

    def close(self) -> None:
        """Finish pending calls, then close; waits for the threads."""
        self._readers.shutdown()
        self._costly.shutdown()
        self._writer.shutdown()
        self._brief.shutdown()
        self._disconnect()

    @abstractmethod
    def _disconnect(self) -> None:
        """Close every connection; no thread uses one any more."""

    @abstractmethod
    def _read_within(self, work: Work[T]) -> T: ...

    async def _run(self, pool: ThreadPoolExecutor, run: Callable[[Work[T]], T], work: Work[T]) -> T:
        if self.availability is None:
            return await self._begin(pool, run, work)
        self.availability.refuse_while_away()
        return await self.availability.within(self._begin(pool, run, work))

    def _begin(
        self, pool: ThreadPoolExecutor, run: Callable[[Work[T]], T], work: Work[T]
    ) -> asyncio.Future[T]:
        try:
            return asyncio.get_running_loop().run_in_executor(pool, run, work)
        except RuntimeError as error:
            raise StoreError(Message.of("store_closed", path=self.name)) from error


def _look(connection: StoreConnection) -> object:
    return connection.execute("SELECT 1").fetchone()

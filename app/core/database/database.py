"""A store: one thread writes, others read."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from app.core.database.connection import (
    STEPS,
    Synchronous,
    open_for_reading,
    open_for_writing,
    transact,
)
from app.core.database.files import Reserve, in_words
from app.core.database.migration import MIGRATIONS, alone, bring_up_to_date, refuse_unfinished
from app.errors import StoreError
from bus.messages import Message

P = ParamSpec("P")
T = TypeVar("T")
Work = Callable[[sqlite3.Connection], T]
READERS = 4
COSTLY_READERS = 2
COSTLY_S = 3.0
"""CPU time of its thread that one costly read may take."""


class Database:
    """A store in a file. Opening it brings it up to date, and raises StoreError if it cannot be used.
    ``checkpoints`` False: another process, which may have the store open, does that (SQLite 3.40 can lose
    writes when two connections reset the WAL). ``reserve``: disk space that its transactions may use up.
    ``migrated``: the steps that opening took."""

    def __init__(
        self,
        path: Path,
        migrations: Path = MIGRATIONS,
        synchronous: Synchronous = "FULL",
        *,
        checkpoints: bool = True,
        reserve: Reserve | None = None,
    ) -> None:
        self.path = path
        self._reserve = reserve
        with in_words(path), alone(path):
            self._connection = open_for_writing(path, synchronous)
            if not checkpoints:
                self._connection.execute("PRAGMA wal_autocheckpoint = 0")
            refuse_unfinished(self._connection, path)
            self.migrated = bring_up_to_date(self._connection, path, migrations)
        self._writer = ThreadPoolExecutor(1, thread_name_prefix=f"{path.stem}-writer")
        self._readers = ThreadPoolExecutor(READERS, thread_name_prefix=f"{path.stem}-reader")
        self._costly = ThreadPoolExecutor(COSTLY_READERS, thread_name_prefix=f"{path.stem}-costly")
        self._local = threading.local()
        self._opened: list[sqlite3.Connection] = []

    async def write(self, work: Work[T]) -> T:
        """Run ``work`` in one transaction on the writer's thread; it is on disk when this returns."""
        return await self._run(self._writer, self.write_now, work)

    async def read(self, work: Work[T]) -> T:
        """Run ``work`` on a read-only connection in a thread."""
        return await self._run(self._readers, self.read_now, work)

    async def read_costly(self, work: Work[T]) -> T:
        """Run a read that may take long apart from all others. Raise TooCostlyError after `COSTLY_S`."""
        return await self._run(self._costly, self._read_within, work)

    def write_now(self, work: Work[T]) -> T:
        """Run ``work`` in one transaction on this thread: the command line's, or the writer's own."""
        if self._reserve is not None:
            self._reserve.keep()
        with in_words(self.path):
            return transact(self._connection, work)

    def read_now(self, work: Work[T]) -> T:
        """Run ``work`` on a read-only connection of this thread."""
        with in_words(self.path):
            return work(self._reader())

    def give_back(self, pages: int) -> None:
        """Return ``pages`` of deleted rows to the disk. For the writer's own thread."""
        vacuum = f"PRAGMA incremental_vacuum({pages})"
        self.write_now(lambda connection: connection.execute(vacuum).fetchall())

    def close(self) -> None:
        """Finish pending calls, wait for the threads, then close."""
        for pool in (self._readers, self._costly, self._writer):
            pool.shutdown()
        for connection in (*self._opened, self._connection):
            connection.close()

    def _read_within(self, work: Work[T]) -> T:
        connection, end = self._reader(), time.thread_time() + COSTLY_S
        connection.set_progress_handler(lambda: time.thread_time() > end, STEPS)
        try:
            with in_words(self.path):
                return work(connection)
        finally:
            connection.set_progress_handler(None, 0)

    def _reader(self) -> sqlite3.Connection:
        connection: sqlite3.Connection | None = getattr(self._local, "connection", None)
        if connection is None:
            connection = open_for_reading(self.path)
            self._local.connection = connection
            self._opened.append(connection)
        return connection

    async def _run(self, pool: ThreadPoolExecutor, run: Callable[[Work[T]], T], work: Work[T]) -> T:
        try:
            pending = asyncio.get_running_loop().run_in_executor(pool, run, work)
        except RuntimeError as error:
            raise StoreError(Message.of("store_closed", path=str(self.path))) from error
        return await pending


class Tables:
    """The base class for tables of a database; the methods of a subclass are their queries."""

    def __init__(self, database: Database) -> None:
        self.database = database


TablesT = TypeVar("TablesT", bound=Tables)
Query = Callable[Concatenate[TablesT, sqlite3.Connection, P], T]
QueryCall = Callable[Concatenate[TablesT, P], Coroutine[Any, Any, T]]


def reading(query: Query[TablesT, P, T]) -> QueryCall[TablesT, P, T]:
    """Make a query run in a thread, on a connection that cannot write."""

    @wraps(query)
    async def call(tables: TablesT, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await tables.database.read(lambda connection: query(tables, connection, *args, **kwargs))

    return call


def writing(query: Query[TablesT, P, T]) -> QueryCall[TablesT, P, T]:
    """Make a query run as one transaction on the writer's thread; it is on disk when the call returns."""

    @wraps(query)
    async def call(tables: TablesT, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await tables.database.write(lambda connection: query(tables, connection, *args, **kwargs))

    return call

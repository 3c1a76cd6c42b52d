"""The connections to one store: one that writes, on its own thread, and read-only ones."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Literal, TypeVar

from app.database.migrating import MIGRATIONS, Migration, alone, bring_up_to_date
from app.database.private import make_file, make_folder, refuse_link
from app.database.reserve import Reserve
from app.database.words import in_words
from app.errors import StoreError
from bus.messages import Message

T = TypeVar("T")
StoreConnection = sqlite3.Connection
"""The type of a connection in the queries of features, which name no engine."""
Synchronous = Literal["FULL", "NORMAL"]
READERS = 4
COSTLY_READERS = 2
COSTLY_S = 3.0
"""CPU time of the thread that one costly read may take: the load of the machine does not count."""
STEPS = 20_000
"""Steps of SQLite between two checks of the clock: a few milliseconds."""
BUSY_S = 5.0


def open_for_writing(path: Path, synchronous: Synchronous = "FULL") -> sqlite3.Connection:
    """The one connection that writes (and checkpoints). Autocommit: transactions are begun by hand."""
    make_folder(path.parent)
    make_file(path)
    connection = sqlite3.connect(path, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
    connection.row_factory = sqlite3.Row
    # Only in a new store; in one with tables it changes nothing.
    connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute(f"PRAGMA synchronous = {synchronous}")
    connection.execute("PRAGMA foreign_keys = ON")
    # A temporary file of a statement needs a disk with space.
    connection.execute("PRAGMA temp_store = MEMORY")
    return connection


def open_for_reading(path: Path) -> sqlite3.Connection:
    """A connection that cannot write. Raises StoreError for a link."""
    refuse_link(path)
    uri = f"{path.absolute().as_uri()}?mode=ro"
    connection = sqlite3.connect(uri, uri=True, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
    connection.row_factory = sqlite3.Row
    # SQLite takes any bytes for text. One row that is no UTF-8 must not make all the others unreadable.
    connection.text_factory = partial(str, encoding="utf-8", errors="replace")
    return connection


def transact(connection: sqlite3.Connection, work: Callable[[sqlite3.Connection], T]) -> T:
    """``work`` inside one transaction: all of it, or none when it raises."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        result = work(connection)
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise
    return result


class Database:
    """One store. Opening brings it up to date and raises StoreError in words when it cannot be used.

    ``checkpoints`` False: another process may have the store open and does that (SQLite 3.40 can lose
    writes when two connections reset the WAL). ``reserve``: the disk space that its transactions may use up.
    """

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
            self.migrated: list[Migration] = bring_up_to_date(self._connection, path, migrations)
        self._writer = ThreadPoolExecutor(1, thread_name_prefix=f"{path.stem}-writer")
        self._readers = ThreadPoolExecutor(READERS, thread_name_prefix=f"{path.stem}-reader")
        self._costly = ThreadPoolExecutor(COSTLY_READERS, thread_name_prefix=f"{path.stem}-costly")
        self._local = threading.local()
        self._opened: list[sqlite3.Connection] = []

    def give_back(self, pages: int) -> None:
        """Return so many pages of deleted rows to the disk. For the writer's own thread."""
        vacuum = f"PRAGMA incremental_vacuum({pages})"
        self.write_now(lambda connection: connection.execute(vacuum).fetchall())

    async def write(self, work: Callable[[sqlite3.Connection], T]) -> T:
        """Run ``work`` in one transaction on the writer's thread; it is on disk when this returns."""
        return await self._run(self._writer, self.write_now, work)

    async def read(self, work: Callable[[sqlite3.Connection], T]) -> T:
        """Run ``work`` on a read-only connection in a thread."""
        return await self._run(self._readers, self.read_now, work)

    async def read_costly(self, work: Callable[[sqlite3.Connection], T]) -> T:
        """Run a read that may take long, apart from all others. Raises TooCostlyError after `COSTLY_S`."""
        return await self._run(self._costly, self._read_within, work)

    def write_now(self, work: Callable[[sqlite3.Connection], T]) -> T:
        """Run ``work`` in one transaction on this thread: the command line's, or the writer's own."""
        if self._reserve is not None:
            self._reserve.keep()
        with in_words(self.path):
            return transact(self._connection, work)

    def read_now(self, work: Callable[[sqlite3.Connection], T]) -> T:
        """Run ``work`` on a read-only connection of this thread."""
        with in_words(self.path):
            return work(self._reader())

    def close(self) -> None:
        """Finish pending calls, then close; waits for the threads."""
        self._readers.shutdown()
        self._costly.shutdown()
        self._writer.shutdown()
        for connection in (*self._opened, self._connection):
            connection.close()

    def _read_within(self, work: Callable[[sqlite3.Connection], T]) -> T:
        connection, end = self._reader(), time.thread_time() + COSTLY_S
        connection.set_progress_handler(lambda: time.thread_time() > end, STEPS)
        try:
            with in_words(self.path):
                return work(connection)
        finally:
            connection.set_progress_handler(None, 0)

    async def _run(
        self,
        pool: ThreadPoolExecutor,
        run: Callable[[Callable[[sqlite3.Connection], T]], T],
        work: Callable[[sqlite3.Connection], T],
    ) -> T:
        try:
            future = asyncio.get_running_loop().run_in_executor(pool, run, work)
        except RuntimeError as error:
            raise StoreError(Message.of("store_closed", path=str(self.path))) from error
        return await future

    def _reader(self) -> sqlite3.Connection:
        connection: sqlite3.Connection | None = getattr(self._local, "connection", None)
        if connection is None:
            connection = open_for_reading(self.path)
            self._local.connection = connection
            self._opened.append(connection)
        return connection

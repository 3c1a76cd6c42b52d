"""A store of SQLite: one connection that writes, on its own thread, and read-only ones."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

from app.database.database import COSTLY_S, Database, Listener, Work
from app.database.migration import MIGRATIONS
from app.database.private import make_file, make_folder, refuse_link
from app.database.sqlite.migrating import alone, bring_up_to_date, is_unfinished
from app.database.sqlite.reserve import Reserve
from app.database.sqlite.words import in_words
from app.database.unfinished import refuse_unfinished

T = TypeVar("T")
Synchronous = Literal["FULL", "NORMAL"]
STEPS = 20_000
"""Steps of SQLite between two checks of the clock: a few milliseconds."""
BUSY_S = 5.0


class WritingConnection(sqlite3.Connection):
    """The one connection of a store that writes."""

    def __init__(self, *place: Any, **options: Any) -> None:
        super().__init__(*place, **options)
        self.notices: list[tuple[str, str]] = []
        """Channels and texts that the present transaction notifies, once it is committed."""


def open_for_writing(path: Path, synchronous: Synchronous = "FULL") -> WritingConnection:
    """The one connection that writes (and checkpoints). Autocommit: transactions are begun by hand."""
    make_folder(path.parent)
    make_file(path)
    connection = sqlite3.connect(
        path, timeout=BUSY_S, isolation_level=None, check_same_thread=False, factory=WritingConnection
    )
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
    return _opened(path, "mode=ro")


def open_unchanged(path: Path) -> sqlite3.Connection:
    """A connection that reads and leaves no file, also on a read-only disk. Where no process has the store
    open and none left a log, SQLite would make both for a reader. Raises StoreError for a link."""
    log, shared = (path.with_name(path.name + companion) for companion in ("-wal", "-shm"))
    if not log.exists():
        return _opened(path, "mode=ro&immutable=1")
    if shared.exists():
        return _opened(path, "mode=ro")
    # A copy, or what a power failure left: no process has it open. The index of the log is made in memory.
    connection = _opened(path, "mode=ro&vfs=unix-none")
    connection.execute("PRAGMA locking_mode = EXCLUSIVE")
    return connection


def _opened(path: Path, how: str) -> sqlite3.Connection:
    refuse_link(path)
    uri = f"{path.absolute().as_uri()}?{how}"
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


class SqliteDatabase(Database):
    """A store in a file of this machine.

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
        self.path = self.file = path
        self._reserve = reserve
        with in_words(path), alone(path):
            self._connection = open_for_writing(path, synchronous)
            if not checkpoints:
                self._connection.execute("PRAGMA wal_autocheckpoint = 0")
            refuse_unfinished(str(path), has_ledger=is_unfinished(self._connection))
            self.migrated = bring_up_to_date(self._connection, path, migrations)
        super().__init__(str(path), path.stem)
        self._local = threading.local()
        self._opened: list[sqlite3.Connection] = []
        self._listeners: list[tuple[str, asyncio.AbstractEventLoop, Listener]] = []

    def write_now(self, work: Work[T]) -> T:
        if self._reserve is not None:
            self._reserve.keep()
        connection = self._connection
        try:
            with in_words(self.path):
                result = transact(connection, work)
            if connection.notices:
                self._deliver(connection.notices)
        finally:
            connection.notices.clear()
        return result

    def read_now(self, work: Work[T]) -> T:
        with in_words(self.path):
            return work(self._reader())

    def listen(self, channel: str, callback: Listener) -> None:
        self._listeners.append((channel, asyncio.get_running_loop(), callback))

    def interrupt(self) -> None:
        """No other machine has the store."""

    def give_back(self, pages: int) -> None:
        vacuum = f"PRAGMA incremental_vacuum({pages})"
        self.write_now(lambda connection: connection.execute(vacuum).fetchall())

    def _deliver(self, notices: list[tuple[str, str]]) -> None:
        for noticed, text in notices:
            for channel, loop, callback in self._listeners:
                if channel == noticed and not loop.is_closed():
                    loop.call_soon_threadsafe(callback, text)

    def _disconnect(self) -> None:
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

"""Connections to a store, one that writes and those that only read, and SQL that queries share."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Literal, TypeVar

import msgspec

from app.core.database.files import in_words, make_file, make_folder, refuse_link
from bus.messages import Message

T = TypeVar("T")
StoreConnection = sqlite3.Connection
StoreRow = sqlite3.Row
Synchronous = Literal["FULL", "NORMAL"]
CACHE_KIB = 256
"""The KiB of its store that a reading connection caches. There are a dozen connections; SQLite would give
each 2 MiB, and the system caches the pages of the file anyway."""
STEPS = 20_000
"""Steps of SQLite between two checks of the clock: a few milliseconds."""
BUSY_S = 5.0
UNREADABLE = Message("stored_text_unreadable")
_DECODER = msgspec.json.Decoder(list[Message])


def open_for_writing(path: Path, synchronous: Synchronous = "FULL") -> sqlite3.Connection:
    """Open the one connection that writes and checkpoints. It is in autocommit: transactions are begun by
    hand."""
    make_folder(path.parent)
    make_file(path)
    connection = sqlite3.connect(path, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
    _set_factories(connection)
    # This takes effect in a new store only.
    connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute(f"PRAGMA synchronous = {synchronous}")
    connection.execute("PRAGMA foreign_keys = ON")
    # Temporary files of statements would need a disk with free space.
    connection.execute("PRAGMA temp_store = MEMORY")
    return connection


def open_for_reading(path: Path) -> sqlite3.Connection:
    """Open a connection that cannot write. Raise StoreError for a link."""
    connection = _opened(path, "mode=ro")
    connection.execute(f"PRAGMA cache_size = -{CACHE_KIB}")
    return connection


def open_unchanged(path: Path) -> sqlite3.Connection:
    """Open a connection that reads and leaves no file, even on a read-only disk: for a reader alone SQLite
    would make a log and its index. Raise StoreError for a link."""
    log, shared = (path.with_name(path.name + companion) for companion in ("-wal", "-shm"))
    if not log.exists():
        return _opened(path, "mode=ro&immutable=1")
    if shared.exists():
        return _opened(path, "mode=ro")
    # This is a copy, or left by a power failure: no process has it open. The log's index is made in memory.
    connection = _opened(path, "mode=ro&vfs=unix-none")
    connection.execute("PRAGMA locking_mode = EXCLUSIVE")
    return connection


def _opened(path: Path, how: str) -> sqlite3.Connection:
    refuse_link(path)
    uri = f"{path.absolute().as_uri()}?{how}"
    connection = sqlite3.connect(uri, uri=True, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
    _set_factories(connection)
    return connection


def _set_factories(connection: sqlite3.Connection) -> None:
    connection.row_factory = sqlite3.Row
    # SQLite stores any bytes as text: one row that is not UTF-8 must not make all others unreadable.
    connection.text_factory = partial(str, encoding="utf-8", errors="replace")


@contextmanager
def examining(store: Path) -> Iterator[sqlite3.Connection]:
    """Read a store and leave no file beside it. Raise StoreError, which has the fault in words."""
    with in_words(store), closing(open_unchanged(store)) as connection:
        yield connection


def transact(connection: sqlite3.Connection, work: Callable[[sqlite3.Connection], T]) -> T:
    """Run ``work`` in one transaction, which is rolled back if it raises."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        result = work(connection)
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise
    return result


@contextmanager
def snapshot(connection: sqlite3.Connection) -> Iterator[None]:
    """Read everything within this context as of one instant."""
    connection.execute("BEGIN")
    try:
        yield
    finally:
        connection.execute("ROLLBACK")


def json_member(column: str, path: str) -> str:
    """Return SQL for the text at a path of a JSON column, such as ``what.code``; NULL if it is not JSON."""
    return f"CASE WHEN json_valid({column}) THEN CAST(json_extract({column}, '$.{path}') AS TEXT) END"


def upsert(table: str, key: Sequence[str], values: Sequence[str]) -> str:
    """Return SQL that stores a row, the columns of its key first, and replaces one with the same key."""
    columns, replaced = (*key, *values), ", ".join(f"{name} = excluded.{name}" for name in values)
    row = f"({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})"
    return f"INSERT INTO {table} {row} ON CONFLICT ({', '.join(key)}) DO UPDATE SET {replaced}"


def has_column(connection: sqlite3.Connection, table: str, column: str) -> bool:
    """Return whether a store of any version has this column."""
    query = "SELECT 1 FROM pragma_table_info(?) WHERE name = ?"
    return connection.execute(query, (table, column)).fetchone() is not None


def has_table(connection: sqlite3.Connection, table: str) -> bool:
    """Return whether a store of any version has this table."""
    query = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"
    return connection.execute(query, (table,)).fetchone() is not None


def size_of(connection: sqlite3.Connection) -> int:
    """Return the bytes of a store, without its log."""
    query = "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size"
    return int(connection.execute(query).fetchone()[0])


def is_intact(connection: sqlite3.Connection, table: str = "") -> bool:
    """Return whether the pages of one table, or of all, are sound. Raise DamagedStoreError if even that
    cannot be checked."""
    check = f"PRAGMA quick_check({table})" if table else "PRAGMA quick_check"
    return [row[0] for row in connection.execute(check)] == ["ok"]


def stored_messages(messages: Sequence[Message]) -> str:
    """Return messages as the JSON of a column."""
    return msgspec.json.encode(messages).decode()


def messages_of(text: str) -> list[Message]:
    """Return the messages of a column; a text without any, which nothing here writes, becomes one message."""
    try:
        return _DECODER.decode(text)
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return [UNREADABLE]

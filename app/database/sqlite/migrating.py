"""Bringing a store of SQLite up to date: numbered SQL files, forward only, a copy of the store first."""

from __future__ import annotations

import fcntl
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from app.database.migration import Migration, failed_step, missing_in
from app.database.private import make_file, make_folder
from app.database.sqlite.copies import copy_of, remove_older_copies
from app.database.unfinished import LEDGER
from bus.instants import unix_now

_LEDGER = """
CREATE TABLE IF NOT EXISTS migrations (
    number INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    applied_at REAL NOT NULL
) STRICT
"""


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Lock out other processes that open the store: two on a new one would take its first step twice."""
    make_folder(path.parent)
    held = path.with_name(f"{path.name}.opening")
    make_file(held)
    with held.open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def bring_up_to_date(connection: sqlite3.Connection, path: Path, folder: Path) -> list[Migration]:
    """Apply missing steps, each completely or not at all, and return them. ``connection`` is in
    autocommit. Raises StoreError for a store of a newer version and for a step that fails."""
    applied = _applied(connection)
    missing = missing_in(applied, folder, str(path))
    if missing and applied:
        _copy(connection, path, missing[0])
    for migration in missing:
        _apply(connection, path, migration)
    return missing


def is_store(connection: sqlite3.Connection) -> bool:
    """Whether Lineside made the store, and not another program."""
    exists = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'migrations'"
    return connection.execute(exists).fetchone() is not None


def is_unfinished(connection: sqlite3.Connection) -> bool:
    """Whether the store is a copy that is not finished."""
    exists = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"
    return connection.execute(exists, (LEDGER,)).fetchone() is not None


def _applied(connection: sqlite3.Connection) -> dict[int, str]:
    if not is_store(connection):
        return {}
    return dict(connection.execute("SELECT number, name FROM migrations"))


def _copy(connection: sqlite3.Connection, path: Path, step: Migration) -> None:
    copy = copy_of(path, "before", f"{step.number:04d}")
    copy.unlink(missing_ok=True)
    make_file(copy)
    connection.execute("VACUUM INTO ?", (str(copy),))
    remove_older_copies(path, "before")


def _apply(connection: sqlite3.Connection, path: Path, step: Migration) -> None:
    row = f"({step.number}, '{step.name}', {unix_now():.3f})"
    record = f"{_LEDGER};\nINSERT INTO migrations VALUES {row}"
    try:
        connection.executescript(f"BEGIN IMMEDIATE;\n{step.sql};\n{record};\nCOMMIT")
    except sqlite3.OperationalError as error:
        if connection.in_transaction:
            connection.rollback()
        raise failed_step(step, str(path), error) from error

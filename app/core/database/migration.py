"""The opening of a store: whether it exists and may be used, and the numbered steps, forward only and after a
copy, that bring it up to date."""

from __future__ import annotations

import fcntl
import re
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import structlog

from app.core.database.connection import STEPS, examining, has_table, is_intact
from app.core.database.files import in_words, make_file, make_folder
from app.errors import DamagedStoreError, StoreError
from bus.instants import unix_now
from bus.messages import Message

MIGRATIONS = Path(__file__).parent / "migrations"
FIRST = 1
"""The number of the step that creates a store."""
_NAME = re.compile(r"^(\d{4})_([a-z0-9_]+)\.sql$")
_LEDGER = """
CREATE TABLE IF NOT EXISTS migrations (
    number INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    applied_at REAL NOT NULL
) STRICT
"""
COPYING = "copying"
"""The table of a store that the ``lineside migrate-store`` of version 0.2 has not copied completely."""
CopyKind = Literal["before", "damaged"]
"""Kinds of copies beside a store: from before a step to a newer version; set aside with damaged pages."""
MAX_COPIES = 2
"""The number of copies of each kind that stay."""
COMPANIONS = ("-wal", "-shm")
"""The suffixes of the files that SQLite has beside a store in WAL mode."""
log = structlog.get_logger()


@dataclass(frozen=True)
class Migration:
    """A numbered step of a store to a newer version."""

    number: int
    name: str
    sql: str


def migrations_in(folder: Path) -> list[Migration]:
    """Return every ``NNNN_name.sql`` of a folder in order."""
    found = ((path, _NAME.match(path.name)) for path in sorted(folder.glob("*.sql")))
    return [Migration(int(name[1]), name[2], path.read_text("utf-8")) for path, name in found if name]


def _missing_in(applied: dict[int, str], folder: Path, store: str) -> list[Migration]:
    """Return the steps of a folder that a store has not taken. Raise StoreError for a store of a newer
    version."""
    known = migrations_in(folder)
    newer = set(applied) - {migration.number for migration in known}
    if newer:
        step, called = f"{max(newer):04d}", applied[max(newer)]
        raise StoreError(Message.of("store_of_newer_version", path=store, step=step, called=called))
    return [migration for migration in known if migration.number not in applied]


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
    autocommit. Raise StoreError for a store of a newer version and for a step that fails."""
    applied = _applied_steps(connection)
    missing = _missing_in(applied, folder, str(path))
    if missing and applied:
        _copy(connection, path, missing[0])
    for migration in missing:
        _apply(connection, path, migration)
    return missing


def is_store(connection: sqlite3.Connection) -> bool:
    """Return whether Lineside made the store, and not another program."""
    return has_table(connection, "migrations")


def _applied_steps(connection: sqlite3.Connection) -> dict[int, str]:
    """Return number and name of the steps that a store has taken."""
    if not is_store(connection):
        return {}
    return dict(map(tuple, connection.execute("SELECT number, name FROM migrations")))


def refuse_newer(connection: sqlite3.Connection, path: Path) -> list[Migration]:
    """Return the steps that a main store has not taken. Raise StoreError for a store of a newer version."""
    return _missing_in(_applied_steps(connection), MIGRATIONS, str(path))


def require_version(connection: sqlite3.Connection, path: Path) -> None:
    """Raise StoreError for a main store of an earlier or a newer version."""
    if refuse_newer(connection, path):
        raise StoreError(Message.of("store_of_earlier_version", path=str(path)))


def refuse_unfinished(connection: sqlite3.Connection, path: Path) -> None:
    """Raise StoreError for a store that was not copied completely."""
    if has_table(connection, COPYING):
        raise StoreError(Message.of("store_unfinished", path=str(path)))


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
        number, why = f"{step.number:04d}", str(error)
        failed = Message.of("store_step_failed", path=str(path), step=number, called=step.name, error=why)
        raise StoreError(failed) from error


def copy_of(store: Path, kind: CopyKind, label: str) -> Path:
    """Return the path of a copy. Labels of a kind sort by age: the number of a step, a UTC time."""
    return store.with_name(f"{store.name}.{kind}-{label}")


def put_aside(store: Path) -> Path:
    """Rename a damaged store that is closed, with its companions; return its new name."""
    aside = copy_of(store, "damaged", time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()))
    for suffix in ("", *COMPANIONS):
        with suppress(FileNotFoundError):
            store.with_name(store.name + suffix).rename(aside.with_name(aside.name + suffix))
    remove_older_copies(store, "damaged")
    return aside


def remove_older_copies(store: Path, kind: CopyKind) -> None:
    """Remove all but the newest `MAX_COPIES`, each with its companions. One that cannot be removed stays."""
    found = store.parent.glob(copy_of(store, kind, "*").name)
    copies = sorted(path for path in found if not path.name.endswith(COMPANIONS))
    for copy in copies[:-MAX_COPIES]:
        try:
            for suffix in ("", *COMPANIONS):
                copy.with_name(copy.name + suffix).unlink(missing_ok=True)
        except OSError as error:
            log.warning("copy of a store not removed", path=str(copy), error=str(error))


Presence = Literal["sound", "missing", "empty", "damaged"]


def refusal_to_start(store: Path, presence: Presence, key: Path | None, *, new: bool) -> Message | None:
    """Return why a server does not start on a store, None if it may. ``key``: the key file of its audit log
    if it exists, which is made together with the store; ``new``: whether a new site is wanted. Pure."""
    match presence:
        case "sound":
            return Message.of("store_not_new", path=str(store)) if new else None
        case "damaged":
            return None if new else Message.of("store_damaged_at_start", path=str(store))
        case "missing" | "empty":
            if new or key is None:
                return None
            return Message.of(f"store_{presence}_at_start", path=str(store), key=str(key))


def presence_of(store: Path) -> Presence:
    """Return whether a store is there, and in which state; nothing is created. Raise StoreError."""
    try:
        with in_words(store):
            if not store.exists():
                return "missing"
            if not store.stat().st_size:
                return "empty"
            with examining(store) as connection:
                return "sound" if connection.execute("SELECT 1 FROM sqlite_master").fetchone() else "empty"
    except DamagedStoreError:
        return "damaged"


def proves_intact(store: Path, stop: Callable[[], bool]) -> bool:
    """Return whether every page of a store is sound. Raise StoreError if ``stop`` ended the check early."""
    try:
        with examining(store) as connection:
            connection.set_progress_handler(stop, STEPS)
            return is_intact(connection)
    except DamagedStoreError:
        return False

"""Opens a store of a site, with the engine that its configuration names."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from app.database.availability import Availability
from app.database.database import Database
from app.database.migration import MIGRATIONS, Migration, missing_in
from app.database.presence import Presence, examining, presence_of
from app.database.settings import StoreSettings
from app.database.sqlite.connection import SqliteDatabase, Synchronous
from app.database.sqlite.reserve import Reserve
from app.database.store_connection import StoreConnection
from app.errors import StoreError
from bus.messages import Message

MAIN = "main"
"""The schema of the main store."""


def open_database(
    store: StoreSettings,
    file: Path,
    migrations: Path = MIGRATIONS,
    synchronous: Synchronous = "FULL",
    *,
    checkpoints: bool = True,
    reserve: Reserve | None = None,
    availability: Availability | None = None,
) -> Database:
    """Open a store: ``file``, or the schema of this name in the database. Raises StoreError."""
    if not store.url:
        return SqliteDatabase(file, migrations, synchronous, checkpoints=checkpoints, reserve=reserve)
    require_driver()
    from app.database.postgresql.database import PostgresqlDatabase

    schema = MAIN if migrations == MIGRATIONS else file.stem
    return PostgresqlDatabase(store, schema, migrations, synchronous, availability)


def look_at(store: StoreSettings) -> None:
    """Connect to the database, and leave. Raises StoreError."""
    require_driver()
    from app.database.postgresql.connection import connect
    from app.database.postgresql.words import in_words

    with in_words(store.shown):
        connect(store, MAIN).close()


def main_presence(store: StoreSettings, file: Path) -> Presence:
    """Whether the main store is there, by a first look; nothing is created. Raises StoreError."""
    if not store.url:
        return presence_of(file)
    require_driver()
    from app.database.postgresql.examination import has_site

    return "sound" if has_site(store, MAIN) else "vacant"


def require_finished_database(store: StoreSettings) -> None:
    """Raises StoreError where the database is a copy that is not finished."""
    require_driver()
    from app.database.postgresql.examination import require_finished

    require_finished(store, MAIN)


@contextmanager
def examining_main(store: StoreSettings, file: Path, schema: str = MAIN) -> Iterator[StoreConnection]:
    """Read the main store, or that of another ``schema``, as it is; nothing is brought up to date. Raises
    StoreError in words."""
    if not store.url:
        with examining(file) as connection:
            yield connection
        return
    require_driver()
    from app.database.postgresql import examination

    with examination.examining(store, schema) as examined:
        yield examined


def require_version(connection: StoreConnection, store: str) -> None:
    """Raises StoreError for a main store of an earlier or a newer version. ``store`` names it."""
    if refuse_newer(connection, store):
        raise StoreError(Message.of("store_of_earlier_version", path=store))


def refuse_newer(connection: StoreConnection, store: str) -> list[Migration]:
    """The steps that a main store has not taken. Raises StoreError for one of a newer version."""
    applied = dict(map(tuple, connection.execute("SELECT number, name FROM migrations")))
    return missing_in(applied, MIGRATIONS, store)


def require_driver() -> None:
    """Raises StoreError where the driver of PostgreSQL is not installed."""
    if find_spec("psycopg") is None:
        raise StoreError(Message("store_lacks_driver"))


def require_files(store: StoreSettings, instead: str) -> None:
    """Raises StoreError where the stores are no files; ``instead``: the program of PostgreSQL to use."""
    if store.url:
        raise StoreError(Message.of("store_is_no_file", program=instead))

"""Opens a store of a site, with the engine that its configuration names."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from app.database.connection import SqliteDatabase, Synchronous
from app.database.database import Database
from app.database.migration import MIGRATIONS
from app.database.reserve import Reserve
from app.database.settings import StoreSettings
from app.errors import StoreError
from bus.messages import Message

MAIN = "main"
"""The name of the main store where it is a schema."""


def open_database(
    store: StoreSettings,
    file: Path,
    migrations: Path = MIGRATIONS,
    synchronous: Synchronous = "FULL",
    *,
    checkpoints: bool = True,
    reserve: Reserve | None = None,
) -> Database:
    """Open a store: ``file``, or the schema of this name in the database. Raises StoreError."""
    if not store.url:
        return SqliteDatabase(file, migrations, synchronous, checkpoints=checkpoints, reserve=reserve)
    require_driver()
    from app.database.postgresql.database import PostgresqlDatabase

    schema = MAIN if migrations == MIGRATIONS else file.stem
    return PostgresqlDatabase(store, schema, migrations)


def require_driver() -> None:
    """Raises StoreError where the driver of PostgreSQL is not installed."""
    if find_spec("psycopg") is None:
        raise StoreError(Message("store_lacks_driver"))

"""The stores of tests, of the engine that the running test is about: SQLite, unless it has `both_engines`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Literal

import pytest

from app.database import Database
from app.database.migration import MIGRATIONS
from app.database.opening import open_database
from app.database.settings import IN_FILES, StoreSettings
from tests.postgresql import fresh_database, needs_postgresql, spoiled

Engine = Literal["sqlite", "postgresql"]
ENGINES = ("sqlite", pytest.param("postgresql", marks=needs_postgresql))
both_engines = pytest.mark.usefixtures("engine")
"""Runs a test twice; its stores are made by `open_store`, or of `store_settings`."""
only_sqlite = pytest.mark.only_sqlite
"""Leaves one test of a module with `both_engines` to SQLite: it is about its files."""
_databases: dict[Path, StoreSettings] | None = None
_used = ExitStack()


@contextmanager
def used(engine: Engine) -> Iterator[None]:
    """Within it stores are of this engine."""
    global _databases
    _databases = {} if engine == "postgresql" else None
    with _used:
        try:
            yield
        finally:
            _databases = None


def store_settings(folder: Path) -> StoreSettings:
    """``[store]`` of a site with this data folder: the same database each time."""
    if _databases is None:
        return IN_FILES
    if folder not in _databases:
        _databases[folder] = _used.enter_context(fresh_database())
    return _databases[folder]


def store_table(folder: Path) -> str:
    """The same in lineside.toml."""
    url = store_settings(folder).url
    return f"[store]\nurl = '{url}'\n" if url else ""


def without_trigger(name: str, table: str) -> str:
    """SQL that removes a rule of a table. Its database is of no use to another test."""
    if _databases is None:
        return f"DROP TRIGGER {name}"
    spoiled.update(each.url for each in _databases.values())
    return f"DROP TRIGGER {name} ON {table}"


def open_store(file: Path, migrations: Path = MIGRATIONS, *, checkpoints: bool = True) -> Database:
    """A store of a site with its data in the folder of ``file``."""
    return open_database(store_settings(file.parent), file, migrations, checkpoints=checkpoints)

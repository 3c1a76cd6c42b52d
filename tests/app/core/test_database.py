"""The store: one writer, readers that cannot write, and words for what goes wrong."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from app.core.database import Database
from app.core.database import database as database_module
from app.core.database.connection import open_for_reading
from app.errors import ConstraintError, StoreError
from bus.errors import CallerError

STEP = "CREATE TABLE things (name TEXT PRIMARY KEY) STRICT;\n"


@pytest.fixture
def steps(tmp_path: Path) -> Path:
    folder = tmp_path / "steps"
    folder.mkdir()
    (folder / "0001_things.sql").write_text(STEP)
    return folder


@pytest.fixture
def database(tmp_path: Path, steps: Path) -> Iterator[Database]:
    opened = Database(tmp_path / "data" / "x.db", steps)
    yield opened
    opened.close()


def insert(connection: sqlite3.Connection, name: str) -> None:
    connection.execute("INSERT INTO things VALUES (?)", (name,))


def names(connection: sqlite3.Connection) -> list[str]:
    return [row["name"] for row in connection.execute("SELECT name FROM things ORDER BY name")]


async def test_written_rows_are_read(database: Database) -> None:
    await asyncio.gather(*(database.write(lambda c, n=n: insert(c, str(n))) for n in range(20)))  # type: ignore[misc]
    assert len(await database.read(names)) == 20


async def test_a_transaction_is_complete_or_not_at_all(database: Database) -> None:
    def half(connection: sqlite3.Connection) -> None:
        insert(connection, "a")
        raise ValueError("midway")

    with pytest.raises(ValueError, match="midway"):
        await database.write(half)
    assert await database.read(names) == []


async def test_a_broken_rule_is_for_the_caller(database: Database) -> None:
    await database.write(lambda c: insert(c, "a"))
    with pytest.raises(ConstraintError):
        await database.write(lambda c: insert(c, "a"))
    assert await database.read(names) == ["a"]


async def test_a_number_that_no_column_holds_is_the_askers_fault(database: Database) -> None:
    with pytest.raises(CallerError, match="a number is too large"):
        await database.read(lambda c: c.execute("SELECT ?", (2**63,)).fetchone())


async def test_a_reader_cannot_write(database: Database) -> None:
    with pytest.raises(StoreError, match="it is read-only"):
        await database.read(lambda c: insert(c, "a"))


def test_it_is_durable_and_lets_readers_read_on(
    tmp_path: Path, steps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    as_served: Any = database_module.open_for_writing
    monkeypatch.setattr(database_module, "open_for_writing", as_served.__wrapped__)
    with closing(Database(tmp_path / "x.db", steps)) as database:
        with open_for_reading(database.path) as reading:
            assert reading.execute("PRAGMA journal_mode").fetchone()[0] == "wal"
        assert database._connection.execute("PRAGMA synchronous").fetchone()[0] == 2


async def test_a_closed_database_reports_it(tmp_path: Path, steps: Path) -> None:
    database = Database(tmp_path / "x.db", steps)
    database.close()
    with pytest.raises(StoreError, match="is closed; the server is stopping"):
        await database.read(names)


def test_a_damaged_store_is_reported(tmp_path: Path, steps: Path) -> None:
    path = tmp_path / "x.db"
    path.write_bytes(b"this is no store at all, and long enough to be looked at " * 20)
    with pytest.raises(
        StoreError, match=r"x\.db: it is not a Lineside store, or it is damaged; restore a backup"
    ):
        Database(path, steps)


def test_a_folder_that_cannot_be_made(tmp_path: Path, steps: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="check its folder"):
        Database(tmp_path / "file" / "x.db", steps)


async def test_a_full_disk_is_reported_and_survived(database: Database) -> None:
    database._connection.execute("PRAGMA max_page_count = 8")

    def much(connection: sqlite3.Connection) -> None:
        for number in range(10_000):
            insert(connection, f"{number:0100}")

    with pytest.raises(StoreError, match="the disk is full; nothing was stored; free some space"):
        await database.write(much)
    database._connection.execute("PRAGMA max_page_count = 100000")
    await database.write(lambda c: insert(c, "after"))
    assert await database.read(names) == ["after"]


def test_many_that_open_a_new_store_at_once_take_its_first_step_once(tmp_path: Path) -> None:
    def opened(_: int) -> int:
        database = Database(tmp_path / "new" / "store.db")
        steps = len(database.migrated)
        database.close()
        return steps

    with ThreadPoolExecutor(6) as together:
        steps = list(together.map(opened, range(6)))
    assert sorted(steps)[:-1] == [0] * 5
    assert max(steps) > 0

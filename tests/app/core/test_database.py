"""The store: one thread writes and others read, its connections, and the disk space that is kept for it."""

from __future__ import annotations

import asyncio
import errno
import os
import sqlite3
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from app.core.database import Database, StoreConnection, files
from app.core.database import database as database_module
from app.core.database.connection import (
    has_column,
    is_intact,
    json_member,
    open_for_reading,
    open_for_writing,
    size_of,
    snapshot,
    upsert,
)
from app.core.database.files import FILE, MIN_FREE, MIN_FREE_OF_OTHERS, Reserve
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


async def test_written_rows_are_read_and_no_reader_writes(database: Database) -> None:
    await asyncio.gather(*(database.write(lambda c, n=n: insert(c, str(n))) for n in range(20)))  # type: ignore[misc]
    assert len(await database.read(names)) == 20
    with pytest.raises(StoreError, match="it is read-only"):
        await database.read(lambda c: insert(c, "a"))


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


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Database]:
    opened = Database(tmp_path / "lineside.db")
    yield opened
    opened.close()


def test_a_row_takes_the_place_of_one_with_its_key(store: Database) -> None:
    def work(connection: StoreConnection) -> list[tuple[Any, ...]]:
        for row in (("a", 1, "x", "anna", 1.5), ("a", 2, "y", "anna", 2.5), ("a", 1, "z", "ben", 3.5)):
            connection.execute(upsert("blocks", ("bus", "unit"), ("reason", "set_by", "set_at")), row)
        return [tuple(row) for row in connection.execute("SELECT * FROM blocks ORDER BY unit")]

    assert store.write_now(work) == [("a", 1, "z", "ben", 3.5), ("a", 2, "y", "anna", 2.5)]


def test_a_member_of_a_column_of_json(store: Database) -> None:
    query = f"SELECT {json_member('held', 'what.params.number')} FROM (SELECT CAST(? AS TEXT) AS held) AS one"

    def found(text: str | None) -> str | None:
        return store.read_now(lambda connection: connection.execute(query, (text,)).fetchone()[0])

    assert found('{"what": {"code": "x", "params": {"number": 5}}}') == "5"
    assert [found(text) for text in ('{"what": {"code": "x"}}', "[]", "no JSON", None)] == [None] * 4


def test_columns_of_a_store_of_any_version(store: Database) -> None:
    def found(table: str, column: str) -> bool:
        return store.read_now(lambda connection: has_column(connection, table, column))

    assert found("events", "messages")
    assert not found("events", "nothing")
    assert not found("nothing", "messages")


def test_the_size_is_that_of_the_file(store: Database) -> None:
    store.write_now(lambda connection: connection.execute("CREATE TABLE more (a BLOB)"))
    store.close()
    connection = open_for_writing(store.path)
    size = size_of(connection)
    connection.close()
    assert size == store.path.stat().st_size


def test_a_snapshot_sees_one_instant(store: Database) -> None:
    count = "SELECT count(*) FROM migrations"
    reader = open_for_reading(store.path)
    with snapshot(reader):
        before = reader.execute(count).fetchone()[0]
        store.write_now(lambda connection: connection.execute("DELETE FROM migrations WHERE number = 1"))
        assert reader.execute(count).fetchone()[0] == before
    assert reader.execute(count).fetchone()[0] == before - 1
    reader.close()


def test_intact_pages_of_a_table_and_of_the_store(store: Database) -> None:
    assert store.read_now(is_intact)
    assert store.read_now(lambda connection: is_intact(connection, "events"))


SIZE = 8_000_000


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How many bytes are free."""
    free = {"bytes": 10 * MIN_FREE_OF_OTHERS}
    monkeypatch.setattr(files, "free_bytes", lambda _: free["bytes"])
    return free


def held(folder: Path) -> int:
    """The bytes that are really allocated."""
    return (folder / FILE).stat().st_blocks * 512


@pytest.mark.usefixtures("disk")
def test_the_space_is_allocated_at_the_start(tmp_path: Path) -> None:
    made = Reserve(tmp_path, SIZE)
    assert held(tmp_path) >= SIZE
    assert (tmp_path / FILE).stat().st_mode & 0o077 == 0
    assert (made.left, made.notice) == (1.0, None)


def test_a_small_disk_keeps_half_of_what_it_has(tmp_path: Path, disk: dict[str, int]) -> None:
    disk["bytes"] = SIZE
    made = Reserve(tmp_path, SIZE)
    assert (tmp_path / FILE).stat().st_size == SIZE // 2
    disk["bytes"] = SIZE // 2
    made.close()
    assert Reserve(tmp_path, SIZE).left == 0.5, "nor does it lose that at the next start"
    disk["bytes"] = 10 * MIN_FREE_OF_OTHERS
    assert made.notice is not None
    made.keep()
    assert (made.left, made.notice) == (1.0, None)


def test_before_a_transaction_as_much_is_given_up_as_it_may_need(
    tmp_path: Path, disk: dict[str, int]
) -> None:
    made = Reserve(tmp_path, SIZE)
    disk["bytes"] = MIN_FREE
    made.keep()
    assert made.left == 1.0
    disk["bytes"] = 500_000
    made.keep()
    assert (tmp_path / FILE).stat().st_size == SIZE - MIN_FREE + 500_000
    assert made.left == pytest.approx((SIZE - MIN_FREE + 500_000) / SIZE)
    assert made.notice is not None
    disk["bytes"] = 0
    for _ in range(9):
        made.keep()
    assert (made.left, (tmp_path / FILE).stat().st_size) == (0.0, 0)


def test_it_is_made_again_where_history_has_room_too(tmp_path: Path, disk: dict[str, int]) -> None:
    made = Reserve(tmp_path, SIZE)
    for free, left in ((0, 0.75), (MIN_FREE_OF_OTHERS, 0.75), (MIN_FREE_OF_OTHERS + SIZE, 1.0)):
        disk["bytes"] = free
        made.keep()
        assert made.left == left


def test_a_store_keeps_it_with_each_transaction(tmp_path: Path, disk: dict[str, int]) -> None:
    made = Reserve(tmp_path, SIZE)
    with closing(Database(tmp_path / "store.db", reserve=made)) as database:
        disk["bytes"] = 0
        database.write_now(lambda connection: connection.execute("CREATE TABLE one (number)"))
    assert made.left == 0.75


def test_the_end_gives_it_back_unless_the_disk_is_short(tmp_path: Path, disk: dict[str, int]) -> None:
    made = Reserve(tmp_path, SIZE)
    disk["bytes"] = MIN_FREE_OF_OTHERS - 1
    made.close()
    assert held(tmp_path) >= SIZE
    made = Reserve(tmp_path, SIZE)
    assert made.left == 1.0, "the rest of the run before is taken over"
    disk["bytes"] = MIN_FREE_OF_OTHERS
    made.close()
    assert not (tmp_path / FILE).exists()


@pytest.mark.usefixtures("disk")
def test_a_disk_that_cannot_allocate_is_reported_once_and_stops_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with capture_logs() as logs:
        made = Reserve(tmp_path, SIZE)
        made.keep()
    assert [entry["error"] for entry in logs] == ["[Errno 28] No space left on device"]
    assert (made.left, (tmp_path / FILE).stat().st_size) == (0.0, 0)


def test_a_folder_that_is_gone_does_not_stop_a_transaction(tmp_path: Path) -> None:
    made = Reserve(tmp_path / "data", SIZE)
    (tmp_path / "data" / FILE).unlink()
    (tmp_path / "data").rmdir()
    made.keep()
    made.close()

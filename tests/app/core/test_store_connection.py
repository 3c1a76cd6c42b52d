"""What connections to a store read and write beside rows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.core.database import Database, StoreConnection
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


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('{"what": {"code": "x", "params": {"number": 5}}}', "5"),
        ('{"what": {"code": "x"}}', None),
        ("[]", None),
        ("no JSON", None),
        (None, None),
    ],
)
def test_a_member_of_a_column_of_json(store: Database, text: str | None, found: str | None) -> None:
    query = f"SELECT {json_member('held', 'what.params.number')} FROM (SELECT CAST(? AS TEXT) AS held) AS one"
    assert store.read_now(lambda connection: connection.execute(query, (text,)).fetchone()[0]) == found


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

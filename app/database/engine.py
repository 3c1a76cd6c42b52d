"""The SQL that differs from engine to engine, and what is read of a connection beside rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from app.database.connection import StoreConnection
from bus.instants import UnixTime, unix_now


@contextmanager
def snapshot(connection: StoreConnection) -> Iterator[None]:
    """Everything that is read within is of one instant of the store."""
    connection.execute("BEGIN")
    try:
        yield
    finally:
        connection.execute("ROLLBACK")


def clock(connection: StoreConnection) -> UnixTime:  # noqa: ARG001
    """The time of the store, which is one for all servers that share it."""
    return unix_now()


def lock(connection: StoreConnection, name: str) -> None:
    """Exclude every other transaction with a lock of this name, to the end of this one. Here one at a time
    writes."""


def json_member(column: str, path: str) -> str:
    """SQL for what a column of JSON has at a path, such as ``what.code``; NULL where it is no JSON."""
    return f"CASE WHEN json_valid({column}) THEN json_extract({column}, '$.{path}') END"


def upsert(table: str, key: Sequence[str], values: Sequence[str]) -> str:
    """SQL that stores a row, the columns of its key first, in place of one with the same key."""
    columns, replaced = (*key, *values), ", ".join(f"{name} = excluded.{name}" for name in values)
    row = f"({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})"
    return f"INSERT INTO {table} {row} ON CONFLICT ({', '.join(key)}) DO UPDATE SET {replaced}"


def has_column(connection: StoreConnection, table: str, column: str) -> bool:
    """Whether a store, which may be of any version, has this column."""
    query = "SELECT 1 FROM pragma_table_info(?) WHERE name = ?"
    return connection.execute(query, (table, column)).fetchone() is not None


def size_of(connection: StoreConnection) -> int:
    """The bytes that the store takes, without its log."""
    query = "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size"
    return int(connection.execute(query).fetchone()[0])


def is_intact(connection: StoreConnection, table: str = "") -> bool:
    """Check the pages of one table, or of all. Raises DamagedStoreError where not even that can be done."""
    check = f"PRAGMA quick_check({table})" if table else "PRAGMA quick_check"
    return [row[0] for row in connection.execute(check)] == ["ok"]

"""The SQL that differs from engine to engine, and what is read of a connection beside rows."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from app.database.sqlite.connection import WritingConnection
from app.database.store_connection import StoreConnection
from bus.instants import UnixTime, unix_now

MAX_NOTICE_BYTES = 7999
"""What PostgreSQL takes as the text of one notification."""


@contextmanager
def snapshot(connection: StoreConnection) -> Iterator[None]:
    """Everything that is read within is of one instant of the store."""
    connection.execute("BEGIN" if is_local(connection) else "BEGIN ISOLATION LEVEL REPEATABLE READ")
    try:
        yield
    finally:
        connection.execute("ROLLBACK")


def json_member(column: str, path: str) -> str:
    """SQL for the text at a path of a column of JSON, such as ``what.code``; NULL where it is no JSON."""
    return f"CASE WHEN json_valid({column}) THEN CAST(json_extract({column}, '$.{path}') AS TEXT) END"


def upsert(table: str, key: Sequence[str], values: Sequence[str]) -> str:
    """SQL that stores a row, the columns of its key first, in place of one with the same key."""
    columns, replaced = (*key, *values), ", ".join(f"{name} = excluded.{name}" for name in values)
    row = f"({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})"
    return f"INSERT INTO {table} {row} ON CONFLICT ({', '.join(key)}) DO UPDATE SET {replaced}"


def is_local(connection: StoreConnection) -> bool:
    """Whether the store is a file of this machine, which one server has."""
    return isinstance(connection, sqlite3.Connection)


def clock(connection: StoreConnection) -> UnixTime:
    """Unix time of the store, which all servers share."""
    if is_local(connection):
        return unix_now()
    query = "SELECT CAST(extract(epoch FROM clock_timestamp()) AS double precision)"
    return UnixTime(connection.execute(query).fetchone()[0])


def lock(connection: StoreConnection, name: str) -> None:
    """Let no other transaction of any server that locks this name go on before this one has ended. On SQLite
    one transaction writes at a time."""
    if not is_local(connection):
        query = "SELECT pg_advisory_xact_lock(hashtextextended(current_schema() || '/' || ?, 0))"
        connection.execute(query, (name,))


def durable(connection: StoreConnection) -> None:
    """Let the end of this transaction wait for the disk, on a store whose others do not."""
    if not is_local(connection):
        connection.execute("SET LOCAL synchronous_commit TO on")


def notify(connection: StoreConnection, channel: str, text: str) -> None:
    """Pass a text to every listener of a channel, on all servers, once this transaction is committed.
    ``text``: 1 to `MAX_NOTICE_BYTES` bytes."""
    if isinstance(connection, WritingConnection):
        connection.notices.append((channel, text))
    else:
        connection.execute("SELECT pg_notify(?, ?)", (channel, text))


def has_column(connection: StoreConnection, table: str, column: str) -> bool:
    """Whether a store, which may be of any version, has this column."""
    query = "SELECT 1 FROM pragma_table_info(?) WHERE name = ?"
    if not is_local(connection):
        query = (
            "SELECT 1 FROM information_schema.columns"
            " WHERE table_schema = current_schema() AND table_name = ? AND column_name = ?"
        )
    return connection.execute(query, (table, column)).fetchone() is not None


def tables_in(connection: StoreConnection) -> list[str]:
    """The tables of a store that was made by anyone."""
    query = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
    if not is_local(connection):
        query = (
            "SELECT CAST(relname AS text) FROM pg_class JOIN pg_namespace ON relnamespace = pg_namespace.oid"
            " WHERE relkind IN ('r', 'p') AND nspname = current_setting('search_path')"
        )
    return [name for (name,) in connection.execute(query)]


def tables_without_rights(connection: StoreConnection) -> list[str]:
    """The tables of a site in a database that its user may not read and change; of a file, none."""
    if is_local(connection):
        return []
    rights = " AND ".join(
        f"has_table_privilege(found.oid, '{right}')" for right in ("SELECT", "INSERT", "UPDATE", "DELETE")
    )
    query = (
        "SELECT found.oid::regclass::text FROM pg_class found WHERE found.relkind IN ('r', 'p')"
        f" AND NOT ({rights}) AND EXISTS (SELECT 1 FROM pg_class site"
        " WHERE site.relnamespace = found.relnamespace AND site.relname = 'migrations') ORDER BY 1"
    )
    return [str(name) for (name,) in connection.execute(query)]


def last_number(connection: StoreConnection, table: str, column: str) -> int:
    """The highest number that the engine gave to a row of a table, also one that was removed, if it knows."""
    query, values = "SELECT max(seq) FROM sqlite_sequence WHERE name = ?", [table]
    if not is_local(connection):
        query = (
            "SELECT max(last_value) FROM pg_sequences WHERE schemaname = current_schema()"
            " AND format('%I.%I', schemaname, sequencename) = pg_get_serial_sequence(quote_ident(?), ?)"
        )
        values = [table, column]
    elif not connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'sqlite_sequence'").fetchone():
        return 0
    return int(connection.execute(query, values).fetchone()[0] or 0)


def size_of(connection: StoreConnection) -> int:
    """The bytes that the store takes, without its log."""
    query = "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size"
    if not is_local(connection):
        query = (
            "SELECT CAST(coalesce(sum(pg_total_relation_size(oid)), 0) AS bigint) FROM pg_class"
            " WHERE relkind = 'r' AND relnamespace = CAST(current_schema() AS regnamespace)"
        )
    return int(connection.execute(query).fetchone()[0])


def is_intact(connection: StoreConnection, table: str = "") -> bool:
    """Check the pages of one table, or of all. Raises DamagedStoreError where not even that can be done.
    PostgreSQL checks its pages when it reads them."""
    if not is_local(connection):
        return True
    check = f"PRAGMA quick_check({table})" if table else "PRAGMA quick_check"
    return [row[0] for row in connection.execute(check)] == ["ok"]

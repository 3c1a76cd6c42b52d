"""Stores of PostgreSQL as the sides of a copy."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import TypeVar

import psycopg
from psycopg.sql import SQL, Identifier

from app.database.copying import ledger
from app.database.copying.rows import CopiedRow
from app.database.copying.sides import CopyTarget, StoreSide
from app.database.copying.statements import copy_rows, quoted
from app.database.copying.tables import StoreTable
from app.database.postgresql.connection import PostgresqlConnection, connect, name_of
from app.database.postgresql.database import transact
from app.database.postgresql.migrating import bring_up_to_date
from app.database.postgresql.rows import NamedRow
from app.database.postgresql.words import in_words
from app.database.settings import StoreSettings
from app.database.store_connection import StoreConnection
from app.errors import StoreError
from bus.messages import Message

T = TypeVar("T")
APPLICATION = "lineside migrate-store"
SERVER = "lineside"
"""The application that a server names."""
LOCK = 0x4C434F50
"""Held by the one command that writes into a database."""
_TYPES = {"INTEGER": "int8", "REAL": "float8", "TEXT": "text", "BLOB": "bytea"}


@contextmanager
def reading(store: StoreSettings, schema: str) -> Iterator[StoreSide]:
    """Read a store as it is at this instant, also while servers write it. Raises StoreError."""
    in_these_words = partial(in_words, name_of(store, schema))
    with in_these_words():
        driver = _connect(store, schema, default_transaction_read_only="on")
    with closing(driver):
        with in_these_words():
            driver.execute("BEGIN ISOLATION LEVEL REPEATABLE READ")
        yield StoreSide(name_of(store, schema), PostgresqlConnection(driver), in_these_words)


@contextmanager
def writing(store: StoreSettings, schema: str, steps: Path) -> Iterator[CopyTarget]:
    """Write a store that no other such command writes meanwhile; its tables are made. Raises StoreError."""
    name = name_of(store, schema)
    in_these_words = partial(in_words, name)
    with in_these_words():
        driver = _connect(store, schema)
    with closing(driver):
        with in_these_words():
            _lock(driver, schema, name)
            with driver.transaction():
                driver.execute(SQL("CREATE SCHEMA IF NOT EXISTS {}").format(Identifier(schema)))
                driver.execute(ledger.MAKE.encode())
            bring_up_to_date(driver, schema, steps, name)
        yield DatabaseTarget(name, PostgresqlConnection(driver), in_these_words)


def _lock(driver: psycopg.Connection[NamedRow], schema: str, name: str) -> None:
    """Held until the connection ends. Raises StoreError where another command holds it."""
    found = driver.execute("SELECT pg_try_advisory_lock(hashtextextended(%s, %s))", (schema, LOCK)).fetchone()
    if found != (True,) and found != (1,):
        raise StoreError(Message.of("copy_target_in_use", path=name))


def servers_of(store: StoreSettings) -> int:
    """How many connections servers have to a database. Raises StoreError."""
    with reading(store, "public") as side:
        query = (
            "SELECT count(*) FROM pg_stat_activity"
            " WHERE datname = current_database() AND application_name = ?"
        )
        return int(side.one(query, (SERVER,)))


class DatabaseTarget(CopyTarget):
    """A store of PostgreSQL that is written."""

    connection: PostgresqlConnection

    def transaction(self, work: Callable[[StoreConnection], T]) -> T:
        with self.in_words():
            return transact(self.connection.driver, work, self.name)

    def insert(self, table: StoreTable, rows: Iterable[CopiedRow]) -> None:
        with self.connection.driver.cursor().copy(copy_rows(table).encode()) as stream:
            stream.set_types([_TYPES[each] for each in table.types.values()])
            try:
                for row in rows:
                    stream.write_row(row)
            except (TypeError, AttributeError, struct.error) as error:
                # SQLite may have a text in a column of numbers.
                raise StoreError(Message("copy_of_other_type")) from error

    def number_after(self, table: StoreTable, last: int) -> None:
        column = table.numbered
        assert column is not None
        query = (
            f"SELECT setval(pg_get_serial_sequence(?, ?), greatest(?, coalesce(max({quoted(column)}), 0)))"
            f" FROM {quoted(table.name)} HAVING greatest(?, coalesce(max({quoted(column)}), 0)) > 0"
        )
        with self.in_words():
            self.connection.execute(query, (quoted(table.name), column, last, last))


def _connect(store: StoreSettings, schema: str, **options: str) -> psycopg.Connection[NamedRow]:
    # Between two chunks the other side may take its time.
    return connect(
        store, schema, application_name=APPLICATION, idle_in_transaction_session_timeout=0, **options
    )

"""Stores of SQLite as the sides of a copy."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import TypeVar

from app.database.copying import ledger
from app.database.copying.rows import CopiedRow
from app.database.copying.sides import CopyTarget, StoreSide
from app.database.copying.statements import insert_row
from app.database.copying.tables import StoreTable
from app.database.sqlite.connection import open_for_writing, open_unchanged, transact
from app.database.sqlite.migrating import bring_up_to_date
from app.database.sqlite.words import in_words
from app.database.store_connection import StoreConnection

T = TypeVar("T")


@contextmanager
def reading(file: Path) -> Iterator[StoreSide]:
    """Read a store as it is at this instant, also while a server writes it. Nothing is changed. Raises
    StoreError."""
    with in_words(file):
        connection = open_unchanged(file)
    with closing(connection):
        connection.row_factory = None
        # Bytes that are no text would be another text in the copy: they are damage here.
        connection.text_factory = str
        with in_words(file):
            connection.execute("BEGIN")
        yield StoreSide(str(file), connection, partial(in_words, file))


@contextmanager
def writing(file: Path, steps: Path) -> Iterator[CopyTarget]:
    """Write a store that no other process can open meanwhile; its tables are made. Raises StoreError."""
    with in_words(file):
        connection = open_for_writing(file)
    with closing(connection):
        connection.row_factory = None
        with in_words(file):
            connection.execute("PRAGMA locking_mode = EXCLUSIVE")
            transact(connection, lambda opened: opened.execute(ledger.MAKE))
            bring_up_to_date(connection, file, steps)
        yield FileTarget(str(file), connection, partial(in_words, file))


class FileTarget(CopyTarget):
    """A store of SQLite that is written."""

    connection: sqlite3.Connection

    def transaction(self, work: Callable[[StoreConnection], T]) -> T:
        with self.in_words():
            return transact(self.connection, work)

    def insert(self, table: StoreTable, rows: Iterable[CopiedRow]) -> None:
        self.connection.executemany(insert_row(table), rows)

    def number_after(self, table: StoreTable, last: int) -> None:
        """Only a table that is made with AUTOINCREMENT remembers the numbers of rows that were removed."""
        remembers = "SELECT 1 FROM sqlite_master WHERE name = ? AND sql LIKE '%AUTOINCREMENT%'"
        if self.one(remembers, (table.name,)) and last:
            with self.in_words():
                self.connection.execute("DELETE FROM sqlite_sequence WHERE name = ?", (table.name,))
                self.connection.execute("INSERT INTO sqlite_sequence VALUES (?, ?)", (table.name, last))

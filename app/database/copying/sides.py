"""A store that is open for a copy: to be read as it is, or to be written by this process alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, TypeVar

from app.database.copying.rows import Chunk, CopiedRow, Key, chunk_of
from app.database.copying.statements import quoted, select_chunk
from app.database.copying.tables import StoreTable
from app.database.store_connection import StoreConnection

T = TypeVar("T")


@dataclass(frozen=True)
class StoreSide:
    """One store. ``in_words``: turns failures of its engine into StoreError."""

    name: str
    connection: StoreConnection
    in_words: Callable[[], AbstractContextManager[None]]

    def chunk(self, table: StoreTable, after: Key | None, limit: int) -> Chunk:
        """The next rows of a table, at most so many. Raises StoreError."""
        with self.in_words():
            rows = self.connection.execute(
                select_chunk(table, from_start=after is None), (*(after or ()), limit)
            )
            return chunk_of(table, rows)

    def count(self, table: StoreTable) -> int:
        return int(self.one(f"SELECT count(*) FROM {quoted(table.name)}"))

    def one(self, query: str, values: Sequence[Any] = ()) -> Any:
        """The only value of the only row; None: no row."""
        with self.in_words():
            row = self.connection.execute(query, values).fetchone()
        return None if row is None else row[0]


class CopyTarget(StoreSide, ABC):
    """The store that is written."""

    @abstractmethod
    def transaction(self, work: Callable[[StoreConnection], T]) -> T:
        """Run ``work``: all of it is on disk, or none. Raises StoreError, ConstraintError, CallerError."""

    @abstractmethod
    def insert(self, table: StoreTable, rows: Iterable[CopiedRow]) -> None:
        """Add rows within a transaction."""

    @abstractmethod
    def number_after(self, table: StoreTable, last: int) -> None:
        """Let the engine number the next row with more than ``last``, and more than any row has."""

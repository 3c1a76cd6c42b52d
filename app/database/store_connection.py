"""A connection to a store as the queries of features see it, which name no engine."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Protocol


class StoreRow(Protocol):
    """A row: its values by index and by name, in order, and all of them by ``dict``."""

    def __getitem__(self, key: Any, /) -> Any: ...

    def __iter__(self) -> Iterator[Any]: ...

    def keys(self) -> list[str]: ...


class StoreCursor(Protocol):
    """What a statement found or changed."""

    @property
    def rowcount(self) -> int: ...

    def fetchone(self) -> Any: ...

    def fetchall(self) -> list[Any]: ...

    def __iter__(self) -> Iterator[Any]: ...


class StoreConnection(Protocol):
    """Takes the SQL of features: ``?`` or ``:name`` for a value, SQLite's words where engines differ."""

    def execute(self, sql: str, parameters: Any = (), /) -> StoreCursor: ...

    def executemany(self, sql: str, rows: Iterable[Any], /) -> StoreCursor: ...

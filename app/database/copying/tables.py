"""The tables of a store and how their rows depend on each other, read from what its steps leave in SQLite."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from graphlib import TopologicalSorter
from pathlib import Path

from app.database.sqlite.migrating import bring_up_to_date

STEPS = "migrations"
"""The table of the steps that a store has taken. Each store has its own."""


@dataclass(frozen=True, slots=True)
class StoreTable:
    """A table of a store. ``types``: of each column, in the words of SQLite; ``unique``: lists of columns
    beside the key that no two rows share; ``is_referenced``: rows of other tables depend on its rows."""

    name: str
    types: dict[str, str]
    key: tuple[str, ...]
    unique: tuple[tuple[str, ...], ...]
    is_referenced: bool

    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(self.types)

    @property
    def places(self) -> tuple[int, ...]:
        """Where the columns of the key are in a row."""
        return tuple(self.columns.index(name) for name in self.key)

    @property
    def numbered(self) -> str | None:
        """The column whose numbers the engine gives."""
        return self.key[0] if [self.types[name] for name in self.key] == ["INTEGER"] else None


def tables_of(steps: Path) -> list[StoreTable]:
    """The tables that all steps of a folder make, each after those that its rows refer to."""
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as model:
        bring_up_to_date(model, Path("model"), steps)
        listed = "SELECT name FROM pragma_table_list WHERE schema = 'main' AND type = 'table' ORDER BY name"
        names = [name for (name,) in model.execute(listed) if not name.startswith("sqlite_")]
        parents = {name: _parents(model, name) for name in names if name != STEPS}
        referenced = {parent for those in parents.values() for parent in those}
        ordered = TopologicalSorter({name: those - {name} for name, those in parents.items()}).static_order()
        return [_table(model, name, is_referenced=name in referenced) for name in ordered]


def _parents(model: sqlite3.Connection, table: str) -> set[str]:
    return {name for (name,) in model.execute('SELECT "table" FROM pragma_foreign_key_list(?)', (table,))}


def _table(model: sqlite3.Connection, name: str, *, is_referenced: bool) -> StoreTable:
    columns = model.execute("SELECT name, type, pk FROM pragma_table_info(?)", (name,)).fetchall()
    key = sorted((place, column) for column, _, place in columns if place)
    indexes = model.execute(
        'SELECT name FROM pragma_index_list(?) WHERE "unique" AND origin <> ? ORDER BY name', (name, "pk")
    ).fetchall()
    unique = [
        tuple(column for (column,) in model.execute("SELECT name FROM pragma_index_info(?)", index))
        for index in indexes
    ]
    types = {column: type_name for column, type_name, _ in columns}
    return StoreTable(name, types, tuple(column for _, column in key), tuple(unique), is_referenced)

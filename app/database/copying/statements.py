"""The SQL of a copy, for either engine. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from app.database.copying.tables import StoreTable


def select_chunk(table: StoreTable, *, from_start: bool) -> str:
    """Rows in the order of the key: after a position, which are its first values, and at most so many."""
    columns, key = _list(table.columns), _list(table.key)
    after = "" if from_start else f"WHERE {_tuple(table.key)} > {_marks(table.key)} "
    return f"SELECT {columns} FROM {quoted(table.name)} {after}ORDER BY {key} LIMIT ?"


def insert_row(table: StoreTable) -> str:
    return f"INSERT INTO {quoted(table.name)} ({_list(table.columns)}) VALUES {_marks(table.columns)}"


def copy_rows(table: StoreTable) -> str:
    """The statement of PostgreSQL that takes rows as a stream."""
    return f"COPY {quoted(table.name)} ({_list(table.columns)}) FROM STDIN (FORMAT BINARY)"


def update_row(table: StoreTable) -> str:
    """Its values are those outside of the key, then the key."""
    values = [f"{quoted(name)} = ?" for name in table.columns if name not in table.key]
    return f"UPDATE {quoted(table.name)} SET {', '.join(values)} WHERE {equal(table.key)}"


def delete_row(table: StoreTable) -> str:
    return f"DELETE FROM {quoted(table.name)} WHERE {equal(table.key)}"


def delete_other(table: StoreTable, columns: Sequence[str]) -> str:
    """Delete the row that has these columns as a row has them, and another key: the columns, then the key."""
    return f"DELETE FROM {quoted(table.name)} WHERE {equal(columns)} AND NOT ({equal(table.key)})"


def equal(columns: Sequence[str]) -> str:
    return " AND ".join(f"{quoted(name)} = ?" for name in columns)


def quoted(name: str) -> str:
    """A name of a table or a column that may be a word of SQL."""
    return '"{}"'.format(name.replace('"', '""'))


def _list(names: Sequence[str]) -> str:
    return ", ".join(map(quoted, names))


def _tuple(names: Sequence[str]) -> str:
    return f"({_list(names)})"


def _marks(names: Sequence[str]) -> str:
    return f"({', '.join('?' * len(names))})"

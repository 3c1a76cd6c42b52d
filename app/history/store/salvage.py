"""A store with damaged pages is rebuilt: every row that can still be read, one by one.

A page that SQLite cannot follow makes the store refuse to delete old readings or to fold new ones,
permanently. The damaged file is kept beside the new one, with the time in its name.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

from app.database.connection import Database
from app.database.copies import COMPANIONS, copy_of, remove_older_copies
from app.history.series.runs import DAY, HOUR, MINUTE, micros
from app.history.store import tables
from app.history.store.damage import sound
from bus.instants import unix_now

_SMALL = ("unit", "parameter", "fact", "journal")
_LARGE = {
    "raw": ("start, unit, span, points, data", MINUTE),
    "minutes": ("start, unit, data", HOUR),
    "hours": ("start, unit, data", DAY),
    "bits": ("at, unit, word, until", MINUTE),
    "link": ("at, unit, state, cause", MINUTE),
}
"""Columns, the rising key first, and how far apart its rows lie, µs."""
StoredRow = tuple[Any, ...]
Copy = Callable[[tables.StoreConnection], int]


def put_aside(path: Path) -> Path:
    """Rename a closed store with its log; return its new name. Of those put aside the newest two stay."""
    aside = copy_of(path, "damaged", time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()))
    for suffix in ("", *COMPANIONS):
        with suppress(FileNotFoundError):
            path.with_name(path.name + suffix).rename(aside.with_name(aside.name + suffix))
    remove_older_copies(path, "damaged")
    return aside


def copies(damaged: Path, new: Database) -> Iterator[Copy]:
    """Work for one transaction of the new store after the other; each copies what can be read of a unit, and
    gives how many stretches could not be."""
    with closing(sqlite3.connect(f"{damaged.absolute().as_uri()}?mode=ro", uri=True)) as old:
        yield lambda connection: sum(_copy_small(old, connection, table) for table in _SMALL)
        for unit in new.read_now(tables.every_unit):
            for table in _LARGE:
                yield partial(_copy, old, table, unit)
    yield _note


def _note(new: tables.StoreConnection) -> int:
    new.execute("INSERT INTO damaged VALUES ('store', 0, 0, ?, NULL)", (micros(unix_now()),))
    return 0


def _copy_small(old: sqlite3.Connection, new: tables.StoreConnection, table: str) -> int:
    try:
        for row in old.execute(f"SELECT * FROM {table}"):
            new.execute(f"INSERT OR IGNORE INTO {table} VALUES ({', '.join('?' * len(row))})", row)
    except sqlite3.DatabaseError:
        return 1
    return 0


def _copy(old: sqlite3.Connection, table: str, unit: int, new: tables.StoreConnection) -> int:
    columns, step = _LARGE[table]
    key = columns.split(",")[0]
    query = f"SELECT {columns} FROM {table} WHERE unit = ? AND {key} > ? ORDER BY {key} LIMIT 1"
    insert = f"INSERT OR IGNORE INTO {table} ({columns}) VALUES ({', '.join('?' * (columns.count(',') + 1))})"
    missing = 0
    for row in _each(old, query, unit, step):
        if row is None or (isinstance(row[-1], bytes) and not sound(row[-1])):
            missing += 1
        else:
            new.execute(insert, row)
    return missing


def _each(old: sqlite3.Connection, query: str, unit: int, step: int) -> Iterator[StoredRow | None]:
    """Row after row by a key that rises; None for a stretch that cannot be read, which is stepped over in
    strides that double."""
    key, stride = 0, step
    while key < 1 << 62:
        try:
            row = old.execute(query, (unit, key)).fetchone()
        except sqlite3.DatabaseError:
            if stride == step:
                yield None
            key, stride = key + stride, stride * 2
            continue
        if row is None:
            return
        yield row
        key, stride = row[0], step

"""Limits and blocks of units outlive a store that is put back: what protects a machine goes on doing so."""

from __future__ import annotations

import sqlite3

_TABLES = {
    "blocks": "bus, unit, reason, set_by, set_at",
    "limits": "bus, unit, lowest, highest, largest_step, per_minute, set_by, set_at",
}

Protection = dict[str, list[tuple[object, ...]]]
"""Table → its rows."""


def read_protection(connection: sqlite3.Connection) -> Protection:
    """Every limit and block. Raises sqlite3.Error for a store that cannot be read."""
    return {
        table: [tuple(row) for row in connection.execute(f"SELECT {columns} FROM {table}")]
        for table, columns in _TABLES.items()
    }


def keep_in_force(restored: sqlite3.Connection, protection: Protection) -> None:
    """Put them in the place of those that the restored store has of the same units; its others stay."""
    for table, columns in _TABLES.items():
        marks = ", ".join("?" for _ in columns.split(","))
        restored.executemany(
            f"INSERT OR REPLACE INTO {table} ({columns}) VALUES ({marks})", protection[table]
        )

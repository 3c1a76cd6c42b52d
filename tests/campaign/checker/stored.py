"""What the database holds: commands with their outcomes, transitions of alarms."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Sequence
from typing import Any

from tests.campaign.checker.records import JournalRow, digits

COMMANDS = """
SELECT e.unit, e.new_raw, COALESCE(f.outcome, e.outcome) FROM events e LEFT JOIN events f ON f.about = e.id
WHERE e.kind = 'command' AND e.about IS NULL AND e.new_raw IS NOT NULL AND e.bus = ?
"""
JOURNAL = "SELECT alarm, occurrence, trigger, after FROM alarm_journal WHERE bus = ?"


def commands(store: str, bus: str) -> Counter[tuple[int, int, str]]:
    """How often each (unit, digits, outcome) is in the event log."""
    rows = _query(store, COMMANDS, bus)
    return Counter((unit, digits(raw), outcome) for unit, raw, outcome in rows)


def journal(store: str, bus: str) -> set[JournalRow]:
    """Every transition of the alarms of ``bus``."""
    return {JournalRow(*row) for row in _query(store, JOURNAL, bus)}


def _query(store: str, statement: str, bus: str) -> Sequence[tuple[Any, ...]]:
    return sqlite3.connect(f"file:{store}?mode=ro", uri=True).execute(statement, (bus,)).fetchall()

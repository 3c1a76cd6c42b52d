"""What the database holds: commands with their outcomes, transitions of alarms. SQLite or PostgreSQL."""

from __future__ import annotations

import json
import sqlite3
from collections import Counter
from collections.abc import Sequence
from typing import Any

from tests.campaign.checker.records import JournalRow

SCHEMA = "main"
"""Where PostgreSQL has these tables."""
COMMANDS = """
SELECT e.unit, e.new_raw, COALESCE(f.outcome, e.outcome) FROM events e LEFT JOIN events f ON f.about = e.id
WHERE e.kind = 'command' AND e.about IS NULL AND e.new_raw IS NOT NULL AND e.bus = '{bus}'
"""
LATE = """
SELECT messages FROM events
WHERE kind = 'audit' AND messages LIKE '%event!_outcome!_came!_late%' ESCAPE '!'
"""
"""Outcomes from the local log of a server, whose command its next home had concluded meanwhile."""
SPEEDS = (
    "SELECT id, unit, new_raw FROM events WHERE kind = 'command' AND new_raw IS NOT NULL AND bus = '{bus}'"
)
JOURNAL = "SELECT alarm, occurrence, trigger, after FROM alarm_journal WHERE bus = '{bus}'"


def query(store: str, statement: str) -> Sequence[tuple[Any, ...]]:
    """Rows of ``store``: the URL of a PostgreSQL database, or the file of an SQLite one."""
    if store.startswith("postgresql://"):
        import psycopg

        with psycopg.connect(store, options=f"-c search_path={SCHEMA}") as connection:
            return connection.execute(statement.encode()).fetchall()
    return sqlite3.connect(f"file:{store}?mode=ro", uri=True).execute(statement).fetchall()


def commands(store: str, bus: str) -> Counter[tuple[int, int, str]]:
    """How often each (unit, raw, outcome) is in the event log."""
    found = Counter(tuple(row) for row in query(store, COMMANDS.format(bus=bus)))
    speeds = {number: tuple(speed) for number, *speed in query(store, SPEEDS.format(bus=bus))}
    for (messages,) in query(store, LATE):
        late = json.loads(messages)["what"]["params"]
        if late["event"] in speeds:
            found[*speeds[late["event"]], late["outcome"]] += 1
    return found


def journal(store: str, bus: str) -> set[JournalRow]:
    """Every transition of the alarms of ``bus``."""
    return {JournalRow(*row) for row in query(store, JOURNAL.format(bus=bus))}

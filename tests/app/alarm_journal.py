"""A journal of alarms that a test writes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from app.core.database import Database
from app.line.alarms.journal import AlarmStore
from app.line.alarms.rules.performance import ObservedSpan
from bus.instants import UnixTime

T = 1_790_000_400.0
"""The start of a window of ten minutes."""


class Journal:
    """An alarm list without alarms, over a journal that a test writes."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self.store = AlarmStore(database)
        self.spans = [ObservedSpan(UnixTime(T), UnixTime(T + 1800))]

    def write(self, alarm: str, *rows: tuple[float, str, str, str], priority: str = "low") -> None:
        """Transitions of one alarm: seconds after T, trigger, state before, state after."""
        occurrence = 0
        values = []
        for at, trigger, before, after in rows:
            occurrence += trigger == "rise"
            values.append((T + at, alarm, occurrence, priority, trigger, before, after))
        statement = (
            "INSERT INTO alarm_journal (at, alarm, occurrence, code, name, priority, trigger, before, after,"
            " who, reason) VALUES (?, ?, ?, 'x', 'X', ?, ?, ?, ?, '', '')"
        )
        self._database.write_now(lambda connection: connection.executemany(statement, values))

    def rise(self, alarm: str, *at: float, priority: str = "low") -> None:
        """It rises at each time, and is normal again half a second later."""
        for each in at:
            self.write(
                alarm,
                (each, "rise", "normal", "unack_active"),
                (each + 0.25, "acknowledge", "unack_active", "ack_active"),
                (each + 0.5, "clear", "ack_active", "normal"),
                priority=priority,
            )


@contextmanager
def alarm_journal(folder: Path) -> Iterator[Journal]:
    """An empty one, in a new store."""
    with closing(Database(folder / "store.db")) as database:
        yield Journal(database)

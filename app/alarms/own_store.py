"""The site's own alarms that were added on the page, at rest."""

from __future__ import annotations

import sqlite3
from dataclasses import astuple, dataclass

from app.database import Database
from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class OwnAlarmRow:
    """``alarm``: its key; ``settings``: as JSON; ``request``: who added it, with
    the Idempotency-Key."""

    alarm: str
    settings: str
    who: str
    changed_at: UnixTime
    request: str = ""
    version: int = 0


class OwnAlarmStore:
    """All access to their table."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def load(self) -> list[OwnAlarmRow]:
        """All of them, by key."""
        query = "SELECT alarm, settings, who, changed_at, request, version FROM own_alarm ORDER BY alarm"
        rows = await self._database.read(lambda connection: connection.execute(query).fetchall())
        return [OwnAlarmRow(*row) for row in rows]


class OwnAlarmWriting:
    """Part of a transaction: removes the row of ``alarm``, then adds ``row``. ``version``: that of the row,
    after the transaction; no version is used twice."""

    def __init__(self, alarm: str, row: OwnAlarmRow | None) -> None:
        self._alarm = alarm
        self._row = row
        self.version = 0

    def __call__(self, connection: sqlite3.Connection) -> None:
        connection.execute("DELETE FROM own_alarm WHERE alarm = ?", (self._alarm,))
        if self._row is not None:
            statement = (
                "INSERT INTO own_alarm (alarm, settings, who, changed_at, request) VALUES (?, ?, ?, ?, ?)"
            )
            self.version = connection.execute(statement, astuple(self._row)[:-1]).lastrowid or 0

"""The site's own alarms that were added on the page, at rest."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass

from app.alarms.definition import own_key
from app.alarms.settings import AlarmSettings
from app.database import Database
from bus.instants import UnixTime


@dataclass(slots=True)
class OwnAlarm:
    """One that was added on the page; ``request``: who added it, with the Idempotency-Key."""

    settings: AlarmSettings
    who: str
    at: UnixTime
    request: str
    version: int = 0

    @property
    def key(self) -> str:
        return own_key(self.settings.bus, self.settings.unit, self.settings.name)


class OwnAlarmStore:
    """All access to their table."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def load(self) -> list[sqlite3.Row]:
        """All of them, by key; ``settings`` as JSON."""
        query = "SELECT alarm, settings, who, changed_at, request, version FROM own_alarm ORDER BY alarm"
        return await self._database.read(lambda connection: connection.execute(query).fetchall())


class OwnAlarmWriting:
    """Part of a transaction: removes the row of ``key``, then adds ``own``, which has its version afterwards;
    no version is used twice."""

    def __init__(self, key: str, own: OwnAlarm | None = None) -> None:
        self._key = key
        self._own = own

    def __call__(self, connection: sqlite3.Connection) -> None:
        connection.execute("DELETE FROM own_alarm WHERE alarm = ?", (self._key,))
        own = self._own
        if own is not None:
            statement = (
                "INSERT INTO own_alarm (alarm, settings, who, changed_at, request) VALUES (?, ?, ?, ?, ?)"
            )
            written = own.settings.model_dump_json(exclude_defaults=True)
            row = (own.key, written, own.who, own.at, own.request)
            own.version = connection.execute(statement, row).lastrowid or 0

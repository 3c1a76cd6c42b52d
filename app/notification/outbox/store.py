"""How far the journal of alarms was followed, maintenance, and the key of links, on disk."""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from typing import Annotated

from pydantic import Field

from app.alarms.journal.store import JournalEntry
from app.database import Database, StoreConnection
from app.database.connection import upsert
from app.notification.message.notice import OutboxItem
from app.notification.outbox.outbox import ADD, ADD_NEW, ADD_TO_NOTIFIED, MAX_AGE_S, put
from app.notification.rules.notices import Episode, QuietSpan, opened_by
from app.web.api.shape import InstantObject
from bus.instants import UnixTime

MAX_ENTRIES = 1000
"""Entries of the journal that are followed in one pass."""
_ENTRY = ", ".join(field.name for field in fields(JournalEntry))
_EPISODE = tuple(field.name for field in fields(Episode))


@dataclass(frozen=True, slots=True)
class MaintenanceShown:
    """A maintenance under way."""

    id: int
    bus: Annotated[str | None, Field(description="null: all buses and the server.")]
    since: InstantObject
    until: InstantObject
    who: str
    reason: str

    @property
    def span(self) -> QuietSpan:
        return QuietSpan(self.since, self.until, self.bus)


class NotificationStore:
    """All access to the tables of notification but the outbox."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def load(self, source: str) -> tuple[int, dict[str, Episode]]:
        """How far ``source`` has followed the journal, and its open episodes. Notification that was never on
        begins with the present."""

        def read(connection: StoreConnection) -> tuple[int, dict[str, Episode]]:
            row = connection.execute(
                "SELECT entry FROM notification_cursor WHERE source = ?", (source,)
            ).fetchone()
            cursor = _last_entry(connection) if row is None else row["entry"]
            query = f"SELECT {', '.join(_EPISODE)} FROM notification_episode WHERE source = ?"
            rows = connection.execute(query, (source,)).fetchall()
            return cursor, {row["alarm"]: Episode(*row) for row in rows}

        return await self._database.read(read)

    async def journal_after(self, bus: str | None, cursor: int) -> tuple[list[JournalEntry], int]:
        """The transitions of a bus (None: of the site) after an entry, oldest first, and the last entry that
        was looked at."""

        query = (
            f"SELECT {_ENTRY} FROM alarm_journal WHERE id > ? AND id <= ? AND bus IS ? ORDER BY id LIMIT ?"
        )

        def read(connection: StoreConnection) -> tuple[list[JournalEntry], int]:
            last = _last_entry(connection)
            if last <= cursor:
                return [], cursor
            rows = connection.execute(query, (cursor, last, bus, MAX_ENTRIES))
            entries = [JournalEntry(*row) for row in rows]
            return entries, entries[-1].id if len(entries) == MAX_ENTRIES else last

        return await self._database.read(read)

    async def opened(self, alarms: Iterable[str], cursor: int) -> dict[str, Episode]:
        """The newest episode of each alarm, by its key, that began up to an entry of the journal."""
        keys = list(alarms)
        query = (
            f"SELECT {_ENTRY} FROM alarm_journal WHERE alarm = ? AND id <= ? "
            "AND after IN ('unack_active', 'latched_unack') AND trigger NOT IN ('clear', 'silence') "
            "ORDER BY id DESC LIMIT 1"
        )

        def read(connection: StoreConnection) -> list[JournalEntry]:
            rows = (connection.execute(query, (key, cursor)).fetchone() for key in keys)
            return [JournalEntry(*row) for row in rows if row is not None]

        entries = await self._database.read(read)
        return {entry.alarm: episode for entry in entries if (episode := opened_by(entry)) is not None}

    async def save(
        self,
        source: str,
        cursor: int,
        episodes: Mapping[str, Episode],
        items: Sequence[OutboxItem],
        cleared: Sequence[OutboxItem],
        standing: Sequence[OutboxItem] = (),
    ) -> None:
        """Everything that one pass has led to, in one transaction. ``cleared``: for each address that was
        notified of the occurrence; ``standing``: for each that was not."""
        rows = [(*astuple(episode), source) for episode in episodes.values()]
        marks = ", ".join("?" * (len(_EPISODE) + 1))

        def write(connection: StoreConnection) -> None:
            connection.execute(upsert("notification_cursor", ("source",), ("entry",)), (source, cursor))
            connection.execute("DELETE FROM notification_episode WHERE source = ?", (source,))
            connection.executemany(
                f"INSERT INTO notification_episode ({', '.join(_EPISODE)}, source) VALUES ({marks})", rows
            )
            put(connection, ADD, items)
            put(connection, ADD_NEW, standing)
            put(connection, ADD_TO_NOTIFIED, cleared)

        await self._database.write(write)

    async def quiet(self, now: UnixTime) -> list[MaintenanceShown]:
        """Every maintenance whose end an open alarm may still count from."""
        query = "SELECT id, bus, starts, ends, who, reason FROM notification_quiet WHERE ends > ?"
        rows = await self._database.read(
            lambda connection: connection.execute(query, (float(now - MAX_AGE_S),)).fetchall()
        )
        return [MaintenanceShown(*row) for row in rows]

    async def link_key(self) -> bytes:
        """The key that signs links; made at its first use."""
        fresh = secrets.token_bytes(32)

        def write(connection: StoreConnection) -> bytes:
            connection.execute(
                "INSERT INTO notification_key (id, key) VALUES (1, ?) ON CONFLICT DO NOTHING", (fresh,)
            )
            row = connection.execute("SELECT key FROM notification_key").fetchone()
            return bytes(row["key"])

        return await self._database.write(write)


def begin_quiet(connection: StoreConnection, span: QuietSpan, who: str, reason: str) -> None:
    """Store a maintenance that begins."""
    query = "INSERT INTO notification_quiet (bus, starts, ends, who, reason) VALUES (?, ?, ?, ?, ?)"
    connection.execute(query, (span.bus, float(span.starts), float(span.ends), who, reason))


def end_quiet(connection: StoreConnection, id: int, now: UnixTime) -> None:
    """Store that a maintenance ends before its time."""
    query = "UPDATE notification_quiet SET ends = ? WHERE id = ? AND ends > ?"
    connection.execute(query, (float(now), id, float(now)))


def _last_entry(connection: StoreConnection) -> int:
    last: int = connection.execute("SELECT coalesce(max(id), 0) FROM alarm_journal").fetchone()[0]
    return last

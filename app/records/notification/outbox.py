"""The tables of notification: the outbox with its deliveries, how far the journal of alarms was followed,
maintenance, and the key of links."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from typing import Annotated

import msgspec
from pydantic import Field

from app.core.database import Database, StoreConnection
from app.core.database.connection import upsert
from app.core.web.api.shape import InstantObject
from app.line.alarms.journal import JournalEntry
from app.records.notification.notice import AlarmNotice, OutboxItem, ReportNotice
from app.records.notification.rules.delivery import FLOOD_WINDOW_S, DeliveryState, EndpointLoad, Retry
from app.records.notification.rules.notices import Episode, QuietSpan, opened_by
from bus.instants import UnixTime
from bus.messages import Message

MAX_ITEMS = 200
"""Items in one message."""
MAX_AGE_S = 90 * 86_400.0
STANDING = "standing:"
"""Begins the key of an item of an alarm that stood at a start."""


@dataclass(frozen=True, slots=True)
class NotificationDelivery:
    """One message to one address. ``message_id`` stays the same with every attempt."""

    id: int
    endpoint: str
    message_id: str
    state: DeliveryState
    attempts: int
    created_at: UnixTime
    tried_at: UnixTime
    due: UnixTime
    result: Message | None = None
    items: tuple[OutboxItem, ...] = ()


_DELIVERY = tuple(field.name for field in fields(NotificationDelivery) if field.name != "items")
_ITEM = tuple(field.name for field in fields(OutboxItem))
_VALUES = ":key, :kind, :created_at, :notice, :alarm, :occurrence"
_INTO = f"INSERT INTO notification_item ({_VALUES.replace(':', '')}, endpoint)"
_NOTIFIED = "FROM notification_item WHERE alarm = :alarm AND occurrence = :occurrence AND kind = 'alarm'"
_OF_ENDPOINT = f"{_NOTIFIED} AND endpoint = :endpoint"
_NEW = "ON CONFLICT DO NOTHING"
ADD = f"{_INTO} VALUES ({_VALUES}, :endpoint) {_NEW}"
"""Items that are not there yet."""
ADD_NEW = f"{_INTO} SELECT {_VALUES}, :endpoint WHERE NOT EXISTS (SELECT 1 {_OF_ENDPOINT}) {_NEW}"
"""Items for addresses that were not notified of their occurrence yet."""
ADD_TO_NOTIFIED = f"{_INTO} SELECT {_VALUES}, endpoint {_NOTIFIED} GROUP BY endpoint ORDER BY min(id) {_NEW}"
"""Items for each address that was notified of their occurrence."""


class NotificationOutbox:
    """Access to the tables of the outbox."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def add(self, items: Iterable[OutboxItem]) -> None:
        """Put items into the outbox that are not there yet."""
        several = list(items)
        await self._database.write(lambda connection: put(connection, ADD, several))

    async def interrupted(self, endpoints: Iterable[str], now: UnixTime, gone: Message) -> None:
        """At start: what was being sent is tried again, and what is for no address that is configured is
        canceled."""
        # None is empty; a list of none is no SQL.
        known = ["", *endpoints]
        marks = ", ".join("?" * len(known))

        def write(connection: StoreConnection) -> None:
            connection.execute(
                "UPDATE notification_delivery SET state = 'retrying', due = ? WHERE state = 'sending'",
                (float(now),),
            )
            result = msgspec.json.encode(gone).decode()
            connection.execute(
                "UPDATE notification_delivery SET state = 'canceled', result = ? "
                f"WHERE state = 'retrying' AND endpoint NOT IN ({marks})",
                (result, *known),
            )
            connection.execute(
                f"DELETE FROM notification_item WHERE delivery IS NULL AND endpoint NOT IN ({marks})", known
            )

        await self._database.write(write)

    async def prune(self, now: UnixTime) -> None:
        """Delete messages that are older than three months."""
        before = float(now - MAX_AGE_S)

        def write(connection: StoreConnection) -> None:
            connection.execute("DELETE FROM notification_item WHERE created_at < ?", (before,))
            connection.execute(
                "DELETE FROM notification_delivery WHERE created_at < ? "
                "AND id NOT IN (SELECT delivery FROM notification_item WHERE delivery IS NOT NULL)",
                (before,),
            )

        await self._database.write(write)

    async def load_of(self, endpoint: str, now: UnixTime, *, collects: bool) -> EndpointLoad:
        """Return what there is to send to one address, and what was sent lately."""

        def read(connection: StoreConnection) -> EndpointLoad:
            waiting = connection.execute(
                "SELECT id, created_at, key LIKE ? AS stood FROM notification_item "
                "WHERE delivery IS NULL AND endpoint = ? ORDER BY stood, id LIMIT ?",
                (f"{STANDING}%", endpoint, MAX_ITEMS),
            ).fetchall()
            items = [(id, at) for id, at, stood in waiting if not (stood and collects)]
            standing = [(id, at) for id, at, stood in waiting if stood and collects]
            retries = connection.execute(
                "SELECT id, attempts, due FROM notification_delivery "
                "WHERE state = 'retrying' AND endpoint = ?",
                (endpoint,),
            )
            sent = connection.execute(
                "SELECT tried_at FROM notification_delivery WHERE endpoint = ? AND tried_at > ? "
                "AND state = 'delivered' ORDER BY tried_at DESC LIMIT 1000",
                (endpoint, float(now - FLOOD_WINDOW_S)),
            )
            return EndpointLoad(
                items,
                [Retry(*row) for row in retries],
                [row["tried_at"] for row in sent],
                collects,
                standing,
            )

        return await self._database.read(read)

    async def begin(self, endpoint: str, items: Sequence[int], now: UnixTime) -> NotificationDelivery:
        """Make a message of items. It is on disk as being sent before its first byte leaves."""
        at, message_id = float(now), secrets.token_hex(16)

        def write(connection: StoreConnection) -> NotificationDelivery:
            [(id,)] = connection.execute(
                "INSERT INTO notification_delivery "
                "(endpoint, message_id, state, attempts, created_at, tried_at, due, result) "
                "VALUES (?, ?, 'sending', 0, ?, ?, ?, '') RETURNING id",
                (endpoint, message_id, at, at, at),
            )
            connection.executemany(
                "UPDATE notification_item SET delivery = ? WHERE id = ? AND delivery IS NULL",
                [(id, item) for item in items],
            )
            return _select(connection, "id = ?", (id,), 1)[0]

        return await self._database.write(write)

    async def resume(self, id: int) -> NotificationDelivery:
        """Take up a delivery that is to be tried again, as being sent."""

        def write(connection: StoreConnection) -> NotificationDelivery:
            connection.execute(
                "UPDATE notification_delivery SET state = 'sending' WHERE id = ? AND state = 'retrying'",
                (id,),
            )
            return _select(connection, "id = ?", (id,), 1)[0]

        return await self._database.write(write)

    async def conclude(self, delivery: NotificationDelivery) -> None:
        """Write the result of an attempt."""
        await self._database.write(self.conclusion(delivery))

    def conclusion(self, delivery: NotificationDelivery) -> Callable[[StoreConnection], None]:
        """Return what writes the result of an attempt, as a part of another transaction."""
        result = "" if delivery.result is None else msgspec.json.encode(delivery.result).decode()
        times = float(delivery.tried_at), float(delivery.due)

        def write(connection: StoreConnection) -> None:
            connection.execute(
                "UPDATE notification_delivery SET state = ?, attempts = ?, tried_at = ?, due = ?, result = ? "
                "WHERE id = ? AND state = 'sending'",
                (delivery.state, delivery.attempts, *times, result, delivery.id),
            )

        return write

    async def deliveries(self, limit: int, before: int | None) -> list[NotificationDelivery]:
        """The newest deliveries first; ``before``: older than this one."""
        return await self._deliveries("id < ?", (before or 2**62,), limit)

    async def of_items(self, key: str) -> list[NotificationDelivery]:
        """The deliveries that have an item of this key."""
        where = "id IN (SELECT delivery FROM notification_item WHERE key = ?)"
        return await self._deliveries(where, (key,), 1000)

    async def last_of(self, endpoint: str) -> NotificationDelivery | None:
        """The delivery to an address that was tried last."""
        where = (
            "id = (SELECT id FROM notification_delivery WHERE endpoint = ? ORDER BY tried_at DESC LIMIT 1)"
        )
        return next(iter(await self._deliveries(where, (endpoint,), 1)), None)

    async def waiting(self) -> dict[str, int]:
        """How many items each address has in no message yet."""
        query = "SELECT endpoint, count(*) FROM notification_item WHERE delivery IS NULL GROUP BY endpoint"
        return await self._database.read(lambda connection: dict(connection.execute(query).fetchall()))

    async def _deliveries(
        self, where: str, values: Sequence[object], limit: int
    ) -> list[NotificationDelivery]:
        return await self._database.read(lambda connection: _select(connection, where, values, limit))


def put(connection: StoreConnection, how: str, items: Iterable[OutboxItem]) -> None:
    """Put items into the outbox; ``how`` is `ADD`, `ADD_NEW` or `ADD_TO_NOTIFIED`."""
    connection.executemany(how, [_row(item) for item in items])


def _row(item: OutboxItem) -> dict[str, object]:
    notice = None if item.notice is None else msgspec.json.encode(item.notice).decode()
    return {**asdict(item), "created_at": float(item.created_at), "notice": notice}


def _select(
    connection: StoreConnection, where: str, values: Sequence[object], limit: int
) -> list[NotificationDelivery]:
    """The newest deliveries first, with their items."""
    query = f"SELECT {', '.join(_DELIVERY)} FROM notification_delivery WHERE {where} ORDER BY id DESC LIMIT ?"
    found = []
    for row in connection.execute(query, (*values, limit)).fetchall():
        result = msgspec.json.decode(row["result"], type=Message) if row["result"] else None
        items = _items_of(connection, row["id"])
        found.append(NotificationDelivery(**{**dict(row), "result": result, "items": items}))
    return found


def _items_of(connection: StoreConnection, delivery: int) -> tuple[OutboxItem, ...]:
    query = f"SELECT {', '.join(_ITEM)} FROM notification_item WHERE delivery = ? ORDER BY id"
    found = []
    for row in connection.execute(query, (delivery,)):
        kind: type[AlarmNotice | ReportNotice] = ReportNotice if row["kind"] == "report" else AlarmNotice
        notice = None if row["notice"] is None else msgspec.json.decode(row["notice"], type=kind)
        found.append(OutboxItem(**{**dict(row), "notice": notice}))
    return tuple(found)


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

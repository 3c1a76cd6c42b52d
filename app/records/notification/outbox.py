"""The tables of notification: the outbox of notices with their deliveries, the position in the journal of
alarms, maintenance, and the key of links."""

from __future__ import annotations

import secrets
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields, replace
from typing import Annotated, Literal

import msgspec
from pydantic import Field

from app.core.database import Database, StoreConnection
from app.core.web.shape import InstantObject
from app.line.alarms.alarm import Alarm
from app.line.alarms.journal import JournalEntry
from app.line.alarms.rules import AlarmState
from app.line.conditions.condition import AlarmPriority
from app.records.notification.rules import (
    FLOOD_WINDOW_S,
    DeliveryState,
    EndpointLoad,
    Episode,
    QuietSpan,
    Retry,
    opened_by,
)
from bus.instants import UnixTime
from bus.messages import Message

MAX_ITEMS = 200
"""The most items in one message."""
MAX_AGE_S = 90 * 86_400.0
MAX_ENTRIES = 1000
"""The most journal entries that one pass follows."""
STANDING = "standing:"
"""The start of an item's key, for an alarm that stood at a start of the server."""
NoticeKind = Literal["alarm", "clear", "heartbeat", "test", "report"]


class AlarmNotice(msgspec.Struct, frozen=True):
    """An alarm as it was when its notification was due; times in Unix seconds."""

    id: str
    code: str
    name: Message
    place: str
    """The name of the unit; empty for an alarm of the site."""
    bus: str | None
    unit: int | None
    priority: AlarmPriority
    state: AlarmState
    active: bool
    at: float
    cause: Message
    response: Message
    escalated: bool = False
    """Whether the alarm was not acknowledged within the time of a rule."""


def notice_of(
    alarm: Alarm, place: str, at: UnixTime, state: AlarmState, occurrence: int, *, escalated: bool = False
) -> AlarmNotice:
    """Return the notice of an alarm in a state."""
    definition = alarm.definition
    name = definition.name
    return AlarmNotice(
        id=f"{definition.key}.{occurrence}",
        code=definition.code,
        name=name if isinstance(name, Message) else Message.of("alarm_own_text", text=name),
        place=place,
        bus=definition.bus,
        unit=definition.unit,
        priority=definition.priority,
        state=state,
        active=state in ("unack_active", "ack_active"),
        at=float(at),
        cause=definition.record.cause,
        response=definition.record.response,
        escalated=escalated,
    )


class ReportNotice(msgspec.Struct, frozen=True):
    """A report that is due. ``start`` and ``end`` are in Unix seconds, ``first`` and ``last`` are the same by
    the clock of the site; ``place``: the subject for people; ``bus`` None: the site."""

    every: Literal["shift", "day", "week"]
    start: float
    end: float
    first: str
    last: str
    place: str
    bus: str | None = None
    unit: int | None = None

    @property
    def name(self) -> Message:
        """The title of the report."""
        return Message.of(f"notify_report_{self.every}", place=self.place, first=self.first, last=self.last)


@dataclass(frozen=True, slots=True)
class Attachment:
    """A page as a file. ``summary``: lines for the text of the mail."""

    name: str
    page: str
    summary: tuple[Message, ...] = ()


@dataclass(frozen=True, slots=True)
class ReportAttachments:
    """The maker of report pages: ``make`` returns the page of a report, or raises LinesideError."""

    make: Callable[[ReportNotice], Awaitable[Attachment]]


@dataclass(frozen=True, slots=True)
class OutboxItem:
    """A notice to one address. The outbox has each pair of ``key`` and ``endpoint`` only once."""

    key: str
    endpoint: str
    kind: NoticeKind
    created_at: UnixTime
    notice: AlarmNotice | ReportNotice | None = None
    alarm: str = ""
    occurrence: int = 0
    id: int = 0

    @property
    def alarm_notice(self) -> AlarmNotice | None:
        """The notice, if it is about an alarm."""
        return self.notice if isinstance(self.notice, AlarmNotice) else None


@dataclass(frozen=True, slots=True)
class NotificationDelivery:
    """A message to one address. ``message_id`` stays the same in every attempt."""

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


_DELIVERY = ", ".join(field.name for field in fields(NotificationDelivery) if field.name != "items")
_ITEM = ", ".join(field.name for field in fields(OutboxItem))
_ENTRY = ", ".join(field.name for field in fields(JournalEntry))
_EPISODE = ", ".join(field.name for field in fields(Episode))


class NotificationOutbox:
    """The tables of notification."""

    def __init__(self, database: Database) -> None:
        self._database = database

    # --- items and deliveries -------------------------------------------------------------------------

    async def add(self, items: Iterable[OutboxItem]) -> None:
        """Put items into the outbox, except those that are in it already."""
        several = list(items)
        await self._database.write(lambda connection: _put(connection, several))

    async def interrupted(self, endpoints: Iterable[str], now: UnixTime, gone: Message) -> None:
        """Prepare the outbox at a start: try interrupted messages again, and cancel those for addresses that
        are no longer configured."""
        known = ["", *endpoints]  # `IN ()` is not valid SQL
        marks = ", ".join("?" * len(known))

        def write(connection: StoreConnection) -> None:
            connection.execute(
                "UPDATE notification_delivery SET state = 'retrying', due = ? WHERE state = 'sending'",
                (float(now),),
            )
            connection.execute(
                "UPDATE notification_delivery SET state = 'canceled', result = ? "
                f"WHERE state = 'retrying' AND endpoint NOT IN ({marks})",
                (_encoded(gone), *known),
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
        """Return the messages that wait for one address, and those that were sent recently."""

        def read(connection: StoreConnection) -> EndpointLoad:
            waiting = connection.execute(
                "SELECT id, created_at, key LIKE ? AS stood FROM notification_item "
                "WHERE delivery IS NULL AND endpoint = ? ORDER BY stood, id LIMIT ?",
                (f"{STANDING}%", endpoint, MAX_ITEMS),
            ).fetchall()
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
                items=[(id, at) for id, at, stood in waiting if not (stood and collects)],
                retries=[Retry(*row) for row in retries],
                sent=[row["tried_at"] for row in sent],
                collects=collects,
                standing=[id for id, _, stood in waiting if stood and collects],
            )

        return await self._database.read(read)

    async def begin(self, endpoint: str, items: Sequence[int], now: UnixTime) -> NotificationDelivery:
        """Make a message of items. The disk has it as ``sending`` before its first byte leaves."""
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
        """Mark a delivery that is due again as ``sending``, and return it."""

        def write(connection: StoreConnection) -> NotificationDelivery:
            connection.execute(
                "UPDATE notification_delivery SET state = 'sending' WHERE id = ? AND state = 'retrying'",
                (id,),
            )
            return _select(connection, "id = ?", (id,), 1)[0]

        return await self._database.write(write)

    async def conclude(self, delivery: NotificationDelivery) -> None:
        """Store the result of an attempt."""
        await self._database.write(conclusion(delivery))

    async def deliveries(
        self, limit: int, before: int | None, *, endpoint: str = "", state: str = ""
    ) -> list[NotificationDelivery]:
        """Return deliveries, newest first; ``before``: only those older than this one; ``endpoint``,
        ``state``: only those of the endpoint or state, if given."""
        where = "id < ? AND ? IN ('', endpoint) AND ? IN ('', state)"
        return await self._deliveries(where, (before or 2**62, endpoint, state), limit)

    async def deliveries_with(self, key: str) -> list[NotificationDelivery]:
        """Return the deliveries that have an item of this key."""
        where = "id IN (SELECT delivery FROM notification_item WHERE key = ?)"
        return await self._deliveries(where, (key,), 1000)

    async def last_to(self, endpoint: str) -> NotificationDelivery | None:
        """Return the delivery to an address that was tried last."""
        where = (
            "id = (SELECT id FROM notification_delivery WHERE endpoint = ? ORDER BY tried_at DESC LIMIT 1)"
        )
        return next(iter(await self._deliveries(where, (endpoint,), 1)), None)

    async def waiting(self) -> dict[str, int]:
        """Count the items of each address that are in no message yet."""
        query = "SELECT endpoint, count(*) FROM notification_item WHERE delivery IS NULL GROUP BY endpoint"
        return await self._database.read(lambda connection: dict(connection.execute(query).fetchall()))

    async def _deliveries(
        self, where: str, values: Sequence[object], limit: int
    ) -> list[NotificationDelivery]:
        return await self._database.read(lambda connection: _select(connection, where, values, limit))

    # --- the journal of alarms, as far as it was followed ----------------------------------------------

    async def followed(self) -> tuple[int, dict[str, Episode]]:
        """Return the last journal entry that was followed, and the open episodes by alarm. If notification
        was never on, it begins with the present."""

        def read(connection: StoreConnection) -> tuple[int, dict[str, Episode]]:
            # Earlier versions followed the journal once for each bus, and stored where each of them was.
            [(cursor,)] = connection.execute(
                "SELECT coalesce((SELECT max(entry) FROM notification_cursor), max(id), 0) FROM alarm_journal"
            )
            rows = connection.execute(f"SELECT {_EPISODE} FROM notification_episode")
            return cursor, {row["alarm"]: Episode(*row) for row in rows}

        return await self._database.read(read)

    async def journal_after(self, cursor: int) -> list[JournalEntry]:
        """Return the transitions after an entry of the journal, oldest first."""
        query = f"SELECT {_ENTRY} FROM alarm_journal WHERE id > ? ORDER BY id LIMIT ?"
        rows = await self._database.read(
            lambda connection: connection.execute(query, (cursor, MAX_ENTRIES)).fetchall()
        )
        return [JournalEntry(*row) for row in rows]

    async def opened(self, alarms: Iterable[str], cursor: int) -> dict[str, Episode]:
        """Return the newest episode of each alarm, by its key, that began up to an entry of the journal."""
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
        cursor: int,
        episodes: Mapping[str, Episode],
        items: Sequence[OutboxItem],
        cleared: Sequence[OutboxItem] = (),
        standing: Sequence[OutboxItem] = (),
    ) -> None:
        """Store all results of one pass in one transaction. ``cleared`` goes to each address that was
        notified of the occurrence, ``standing`` only to addresses that were not."""
        rows = [(*astuple(episode), "") for episode in episodes.values()]
        marks = ", ".join("?" * (len(fields(Episode)) + 1))

        def write(connection: StoreConnection) -> None:
            connection.execute("DELETE FROM notification_cursor")
            connection.execute("INSERT INTO notification_cursor (source, entry) VALUES ('', ?)", (cursor,))
            connection.execute("DELETE FROM notification_episode")
            connection.executemany(
                f"INSERT INTO notification_episode ({_EPISODE}, source) VALUES ({marks})", rows
            )
            _put(connection, items)
            _put(connection, [each for each in standing if each.endpoint not in _notified(connection, each)])
            _put(
                connection,
                [replace(each, endpoint=key) for each in cleared for key in _notified(connection, each)],
            )

        await self._database.write(write)

    # --- maintenance and links -------------------------------------------------------------------------

    async def quiet(self, now: UnixTime) -> list[MaintenanceShown]:
        """Return every maintenance from whose end an open alarm may still count."""
        query = "SELECT id, bus, starts, ends, who, reason FROM notification_quiet WHERE ends > ?"
        rows = await self._database.read(
            lambda connection: connection.execute(query, (float(now - MAX_AGE_S),)).fetchall()
        )
        return [MaintenanceShown(*row) for row in rows]

    async def link_key(self) -> bytes:
        """Return the key that signs links; its first use creates it."""
        fresh = secrets.token_bytes(32)

        def write(connection: StoreConnection) -> bytes:
            connection.execute(
                "INSERT INTO notification_key (id, key) VALUES (1, ?) ON CONFLICT DO NOTHING", (fresh,)
            )
            row = connection.execute("SELECT key FROM notification_key").fetchone()
            return bytes(row["key"])

        return await self._database.write(write)


def conclusion(delivery: NotificationDelivery) -> Callable[[StoreConnection], None]:
    """Return a function that stores the result of an attempt as a part of another transaction."""
    result = "" if delivery.result is None else _encoded(delivery.result)
    times = float(delivery.tried_at), float(delivery.due)

    def write(connection: StoreConnection) -> None:
        connection.execute(
            "UPDATE notification_delivery SET state = ?, attempts = ?, tried_at = ?, due = ?, result = ? "
            "WHERE id = ? AND state = 'sending'",
            (delivery.state, delivery.attempts, *times, result, delivery.id),
        )

    return write


def begin_quiet(connection: StoreConnection, span: QuietSpan, who: str, reason: str) -> None:
    """Store a maintenance that begins."""
    query = "INSERT INTO notification_quiet (bus, starts, ends, who, reason) VALUES (?, ?, ?, ?, ?)"
    connection.execute(query, (span.bus, float(span.starts), float(span.ends), who, reason))


def end_quiet(connection: StoreConnection, id: int, now: UnixTime) -> None:
    """Store that a maintenance ends before its time."""
    query = "UPDATE notification_quiet SET ends = ? WHERE id = ? AND ends > ?"
    connection.execute(query, (float(now), id, float(now)))


def _put(connection: StoreConnection, items: Iterable[OutboxItem]) -> None:
    """Put items into the outbox; an item that is in it already stays as it is."""
    connection.executemany(
        "INSERT INTO notification_item (key, endpoint, kind, created_at, notice, alarm, occurrence) "
        "VALUES (:key, :endpoint, :kind, :created_at, :notice, :alarm, :occurrence) ON CONFLICT DO NOTHING",
        [_row(item) for item in items],
    )


def _row(item: OutboxItem) -> dict[str, object]:
    notice = None if item.notice is None else _encoded(item.notice)
    return {**asdict(item), "created_at": float(item.created_at), "notice": notice}


def _notified(connection: StoreConnection, item: OutboxItem) -> list[str]:
    """Return the addresses that were notified of an item's occurrence, in that order."""
    rows = connection.execute(
        "SELECT endpoint FROM notification_item WHERE alarm = ? AND occurrence = ? AND kind = 'alarm' "
        "GROUP BY endpoint ORDER BY min(id)",
        (item.alarm, item.occurrence),
    )
    return [row["endpoint"] for row in rows]


def _select(
    connection: StoreConnection, where: str, values: Sequence[object], limit: int
) -> list[NotificationDelivery]:
    """Return deliveries, newest first, with their items."""
    query = f"SELECT {_DELIVERY} FROM notification_delivery WHERE {where} ORDER BY id DESC LIMIT ?"
    found = []
    for row in connection.execute(query, (*values, limit)).fetchall():
        result = msgspec.json.decode(row["result"], type=Message) if row["result"] else None
        items = _items_of(connection, row["id"])
        found.append(NotificationDelivery(**{**dict(row), "result": result, "items": items}))
    return found


def _items_of(connection: StoreConnection, delivery: int) -> tuple[OutboxItem, ...]:
    query = f"SELECT {_ITEM} FROM notification_item WHERE delivery = ? ORDER BY id"
    found = []
    for row in connection.execute(query, (delivery,)):
        kind: type[AlarmNotice | ReportNotice] = ReportNotice if row["kind"] == "report" else AlarmNotice
        notice = None if row["notice"] is None else msgspec.json.decode(row["notice"], type=kind)
        found.append(OutboxItem(**{**dict(row), "notice": notice}))
    return tuple(found)


def _encoded(value: Message | AlarmNotice | ReportNotice) -> str:
    return msgspec.json.encode(value).decode()

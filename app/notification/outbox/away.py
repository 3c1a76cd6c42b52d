"""Notifies while the database is away, and with it the outbox.

What is to be sent is logged locally before its first byte leaves, and its result after: both come into the
outbox when the database is back, and what was sent is not sent again. A server that is killed in between
sends a message again with the same id, as it does with the outbox.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import msgspec
import structlog

from app.audit.local_log.transaction import StoredPart
from app.audit.log import EventLog
from app.database import StoreConnection
from app.errors import StoreError
from app.notification.message.notice import OutboxItem
from app.notification.outbox.outbox import NotificationDelivery
from app.notification.rules.delivery import DeliveryState, retry_after_s
from app.notification.sending.endpoints import NotificationEndpoint, NotificationPlan
from app.notification.sending.secret_file import NotDeliveredError
from app.notification.sending.senders import Senders
from bus.instants import Clock, unix_now
from bus.messages import Message

SENDING, SENT = "notification_sending", "notification_sent"
"""What a message stores, before and after it is sent."""
MAX_ATTEMPTS = 5
"""Of one message while the database is away; then it waits for the outbox."""
GAP_S = 10.0
"""Between two messages to one address: what rises meanwhile is in the next."""
log = structlog.get_logger()


class AwayNotification:
    """One message after another for each address."""

    def __init__(
        self, plan: NotificationPlan, senders: Senders, events: EventLog, clock: Clock = unix_now
    ) -> None:
        self._plan = plan
        self._senders = senders
        self._events = events
        self._clock = clock
        self._waiting: dict[str, list[OutboxItem]] = {key: [] for key in plan.endpoints}
        self._serving: set[asyncio.Task[None]] = set()
        events.add_writer(SENDING, write_sending)
        events.add_writer(SENT, write_sent)

    def notify(self, items: Sequence[OutboxItem]) -> None:
        """Send items soon, those of one address together."""
        for item in items:
            endpoint = self._plan.endpoints.get(item.endpoint)
            if endpoint is None:
                continue
            waiting = self._waiting[item.endpoint]
            waiting.append(item)
            if len(waiting) == 1:
                task = asyncio.create_task(self._serve(endpoint))
                self._serving.add(task)
                task.add_done_callback(self._serving.discard)

    async def _serve(self, endpoint: NotificationEndpoint) -> None:
        # What rises in the same moment is one message.
        await asyncio.sleep(0)
        waiting = self._waiting[endpoint.key]
        while waiting:
            items = tuple(waiting)
            try:
                await self._deliver(endpoint, items)
            except StoreError as error:
                log.error("a notification was not sent", error=str(error))
            await asyncio.sleep(GAP_S if len(waiting) > len(items) else 0)
            del waiting[: len(items)]

    async def _deliver(self, endpoint: NotificationEndpoint, items: tuple[OutboxItem, ...]) -> None:
        now = self._clock()
        delivery = NotificationDelivery(
            0, endpoint.key, secrets.token_hex(16), "sending", 0, now, now, now, items=items
        )
        await self._events.store_parts([StoredPart(SENDING, _plain(delivery))])
        while delivery.state == "sending":
            delivery = await self._attempt(endpoint, delivery)
            if delivery.state == "sending":
                await asyncio.sleep(retry_after_s(delivery.attempts))
        await self._events.store_parts([StoredPart(SENT, _plain(replace(delivery, items=())))])

    async def _attempt(
        self, endpoint: NotificationEndpoint, delivery: NotificationDelivery
    ) -> NotificationDelivery:
        """After one attempt: delivered, to be tried again here, or by the outbox."""
        failure: Message | None = None
        try:
            await self._senders.send(endpoint, delivery, self._clock())
        except NotDeliveredError as error:
            failure = error.message
        now, attempts = self._clock(), delivery.attempts + 1
        state: DeliveryState = (
            "delivered" if failure is None else "sending" if attempts < MAX_ATTEMPTS else "retrying"
        )
        due = now + retry_after_s(attempts)
        return replace(delivery, state=state, attempts=attempts, tried_at=now, due=due, result=failure)


def local_key(item: OutboxItem) -> str:
    """The key of the same notice where it was sent while the database was away."""
    stage = "" if item.kind == "clear" else item.key.rpartition(":")[2]
    return f"local:{item.kind}:{item.alarm}:{item.occurrence}:{stage}"


def write_sending(connection: StoreConnection, data: Any, _late: bool, /) -> None:
    """Write the part :data:`SENDING`: a message and its items."""
    connection.execute(
        "INSERT INTO notification_delivery "
        "(endpoint, message_id, state, attempts, created_at, tried_at, due, result) "
        "VALUES (?, ?, 'sending', 0, ?, ?, ?, '')",
        (data["endpoint"], data["message_id"], data["created_at"], data["created_at"], data["created_at"]),
    )
    found = connection.execute(
        "SELECT id FROM notification_delivery WHERE message_id = ?", (data["message_id"],)
    ).fetchone()
    connection.executemany(
        "INSERT INTO notification_item "
        "(key, endpoint, kind, created_at, notice, alarm, occurrence, delivery) "
        "VALUES (?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT DO NOTHING",
        [
            (
                *(item["key"], item["endpoint"], item["kind"], item["created_at"]),
                *(item["notice"], item["alarm"], item["occurrence"], found[0]),
            )
            for item in data["items"]
        ],
    )


def write_sent(connection: StoreConnection, data: Any, _late: bool, /) -> None:
    """Write the part :data:`SENT`: what became of a message."""
    connection.execute(
        "UPDATE notification_delivery SET state = ?, attempts = ?, tried_at = ?, due = ?, result = ? "
        "WHERE message_id = ?",
        (
            *(data["state"], data["attempts"], data["tried_at"], data["due"]),
            *(data["result"], data["message_id"]),
        ),
    )


def was_sent_locally(connection: StoreConnection, item: OutboxItem) -> bool:
    """Whether an address had this notice while the database was away."""
    query = "SELECT 1 FROM notification_item WHERE endpoint = ? AND key = ?"
    return connection.execute(query, (item.endpoint, local_key(item))).fetchone() is not None


def forget_sent_clears(connection: StoreConnection, item: OutboxItem) -> None:
    """Take an all-clear back from the addresses that had it while the database was away."""
    connection.execute(
        "DELETE FROM notification_item WHERE key = ? AND delivery IS NULL AND endpoint IN "
        "(SELECT endpoint FROM notification_item WHERE key = ?)",
        (item.key, local_key(item)),
    )


def _plain(delivery: NotificationDelivery) -> dict[str, Any]:
    """A message as JSON."""
    members = asdict(replace(delivery, items=(), result=None))
    items = [{**asdict(replace(item, notice=None)), "notice": _text(item.notice)} for item in delivery.items]
    result = _text(delivery.result) or ""
    plain: dict[str, Any] = msgspec.to_builtins({**members, "items": items, "result": result})
    return plain


def _text(value: msgspec.Struct | None) -> str | None:
    return None if value is None else msgspec.json.encode(value).decode()

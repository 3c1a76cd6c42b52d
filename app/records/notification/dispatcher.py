"""The delivery of the outbox: to all addresses at once, to each address one message after another."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from datetime import datetime

import structlog

from app.errors import StoreError
from app.people.audit.log import EventLog
from app.records.notification.outbox import NotificationDelivery, NotificationOutbox, OutboxItem, conclusion
from app.records.notification.rules import (
    FAILING_ATTEMPTS,
    NotDeliveredError,
    NotificationEndpoint,
    NotificationPlan,
    heartbeat_due,
    next_turn,
    retry_after_s,
    state_after_failure,
)
from app.records.notification.senders import Senders
from app.records.notification.settings import minute_of_day
from bus.instants import UnixTime, unix_now
from bus.messages import Message

HEARTBEAT_CHECK_S = 20.0
STORE_RETRY_S = 1.0
TEST_S = 12.0
"""The time that a test waits for its result."""
log = structlog.get_logger()


class Dispatcher:
    """The dispatcher, which delivers the outbox, sends the daily heartbeat, and knows the failing
    addresses."""

    def __init__(
        self,
        plan: NotificationPlan,
        outbox: NotificationOutbox,
        senders: Senders,
        events: EventLog,
        local_time: Callable[[], datetime],
    ) -> None:
        self.plan = plan
        self._outbox = outbox
        self._senders = senders
        self._events = events
        self.failing: set[str] = set()
        """The keys of the addresses that cannot be reached now."""
        self._local_time = local_time
        self._failures = dict.fromkeys(plan.endpoints, 0)
        self._wakes = {key: asyncio.Event() for key in plan.endpoints}
        self.attempted = asyncio.Event()
        """Set after the next attempt, and then replaced by a new event."""

    def wake(self) -> None:
        """Look at the outbox at once, as it has new items."""
        for each in self._wakes.values():
            each.set()

    async def add(self, items: Iterable[OutboxItem]) -> None:
        """Put items that are new into the outbox, and deliver them."""
        await self._outbox.add(items)
        self.wake()

    async def follow(self) -> None:
        """Deliver the outbox until canceled."""
        if not self.plan.endpoints:
            await asyncio.Event().wait()
        await self._outbox.interrupted(self.plan.endpoints, unix_now(), Message("notify_address_removed"))
        await self._outbox.prune(unix_now())
        await self._find_failing()
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._beat())
            for endpoint in self.plan.endpoints.values():
                tasks.create_task(self._serve(endpoint))

    async def test(self, endpoint: NotificationEndpoint) -> NotificationDelivery | None:
        """Send a test message like any other and return its delivery after the first attempt; None if that
        takes longer than a person waits."""
        key = f"test:{secrets.token_hex(8)}"
        await self.add([OutboxItem(key, endpoint.key, "test", unix_now())])
        with suppress(TimeoutError):
            async with asyncio.timeout(TEST_S):
                while True:
                    attempted = self.attempted
                    found = await self._outbox.deliveries_with(key)
                    if found and found[0].state != "sending":
                        return found[0]
                    await attempted.wait()
        return None

    async def _find_failing(self) -> None:
        for key in self.plan.endpoints:
            last = await self._outbox.last_to(key)
            is_open = last is not None and last.state not in ("delivered", "canceled")
            self._count_failures(key, last.attempts if last is not None and is_open else 0)

    def _count_failures(self, key: str, failures: int) -> None:
        self._failures[key] = failures
        if failures >= FAILING_ATTEMPTS:
            self.failing.add(key)
        else:
            self.failing.discard(key)

    async def _serve(self, endpoint: NotificationEndpoint) -> None:
        while True:
            try:
                await self._take_turn(endpoint)
            except StoreError as error:
                log.error("notifications wait", error=str(error))
                await asyncio.sleep(STORE_RETRY_S)
            except Exception:
                # A fault at one address must not end the other tasks, whose messages may be under way.
                log.exception("notifications of one address wait")
                await asyncio.sleep(STORE_RETRY_S)

    async def _take_turn(self, endpoint: NotificationEndpoint) -> None:
        settings, wake = self.plan.settings, self._wakes[endpoint.key]
        wake.clear()
        now = unix_now()
        load = await self._outbox.load_of(endpoint.key, now, collects=endpoint.kind != "webhook")
        turn = next_turn(load, settings.flood, settings.digest_s, now)
        if turn.items:
            await self._attempt(endpoint, await self._outbox.begin(endpoint.key, turn.items, now))
        elif turn.retry is not None:
            await self._attempt(endpoint, await self._outbox.resume(turn.retry))
        else:
            with suppress(TimeoutError):
                async with asyncio.timeout(turn.wait_s):
                    await wake.wait()

    async def _attempt(self, endpoint: NotificationEndpoint, delivery: NotificationDelivery) -> None:
        failure: Message | None = None
        try:
            await self._senders.send(endpoint, delivery, unix_now())
        except NotDeliveredError as error:
            failure = error.message
        ended = _ended(delivery, failure, unix_now())
        await self._conclude(endpoint, ended)
        self._count_failures(endpoint.key, 0 if failure is None else self._failures[endpoint.key] + 1)
        attempted, self.attempted = self.attempted, asyncio.Event()
        attempted.set()

    async def _conclude(self, endpoint: NotificationEndpoint, ended: NotificationDelivery) -> None:
        """Store the result of an attempt, however long that takes: a message that has left must not be sent
        again because the store was busy."""
        while True:
            try:
                await self._record(endpoint, ended)
            except StoreError as error:
                log.error("the result of a notification waits", error=str(error))
                await asyncio.sleep(STORE_RETRY_S)
            else:
                return

    async def _record(self, endpoint: NotificationEndpoint, ended: NotificationDelivery) -> None:
        """Write the result of an attempt. The first failure and the end are events; the attempts between them
        would hide other events."""
        if ended.state == "retrying" and ended.attempts > 1:
            await self._outbox.conclude(ended)
            return
        first = ended.items[0].notice if len(ended.items) == 1 else None
        await self._events.record(
            kind="notification",
            bus=None if first is None else first.bus,
            unit=None if first is None else first.unit,
            what=Message.of(
                f"event_notification_{ended.state}", to=endpoint.address, subject=subject_of(ended)
            ),
            message=ended.result or "",
            also=conclusion(ended),
        )

    async def _beat(self) -> None:
        minute, before = minute_of_day(self.plan.settings.heartbeat_at), self._local_time()
        while True:
            await asyncio.sleep(HEARTBEAT_CHECK_S)
            now = self._local_time()
            day = heartbeat_due(before, now, minute)
            if day:
                at = unix_now()
                keys = self.plan.present(now)
                await self.add(OutboxItem(f"heartbeat:{day}", key, "heartbeat", at) for key in keys)
                await self._outbox.prune(at)
            before = now


def subject_of(delivery: NotificationDelivery) -> Message:
    """Return the subject of a message, for events and the page."""
    first = delivery.items[0] if delivery.items else None
    if first is None or len(delivery.items) > 1:
        return Message.of("notify_several", n=len(delivery.items))
    notice = first.notice
    if notice is None:
        return Message(f"notify_kind_{first.kind}")
    return Message.of(f"notify_kind_{first.kind}", name=notice.name)


def _ended(delivery: NotificationDelivery, failure: Message | None, now: UnixTime) -> NotificationDelivery:
    attempts = delivery.attempts + 1
    return replace(
        delivery,
        state="delivered" if failure is None else state_after_failure(delivery.created_at, now),
        attempts=attempts,
        tried_at=now,
        due=now + retry_after_s(attempts),
        result=failure,
    )

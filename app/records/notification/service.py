"""The service of notification: present addresses and groups, test messages, maintenance (in which nothing is
notified), and the notifier, which follows the journal of alarms and fills the outbox."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, timedelta
from functools import partial
from itertools import count
from typing import Annotated
from zoneinfo import ZoneInfo

from pydantic import Field
from typing_extensions import TypeAliasType

from app.core.web.access import Person, Role
from app.core.web.services import unknown_bus
from app.core.web.shape import InstantObject, MessageObject
from app.errors import Problem
from app.line.alarms.alarm import Alarm
from app.line.alarms.journal import JournalEntry
from app.line.alarms.line_alarms import LineAlarms
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from app.records.notification.compose import AcknowledgeLinks
from app.records.notification.dispatcher import Dispatcher
from app.records.notification.outbox import (
    MAX_AGE_S,
    STANDING,
    MaintenanceShown,
    NotificationDelivery,
    NotificationOutbox,
    OutboxItem,
    begin_quiet,
    end_quiet,
    notice_of,
)
from app.records.notification.rules import (
    EndpointKind,
    Episode,
    Followed,
    PlannedNotice,
    QuietSpan,
    due,
    follow,
    recurring_spans,
)
from app.records.notification.settings import DAYS, DayOfWeek, MaintenanceSettings
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

BEGIN_MAINTENANCE = Act("begin_maintenance", Role.ENGINEER, "notification", "event_maintenance_begun")
END_MAINTENANCE = Act("end_maintenance", Role.ENGINEER, "notification", "event_maintenance_ended")
SEND_TEST = Act("send_test_notification", Role.ENGINEER, "notification", "event_notification_delivered")
"""A test is recorded as every message is: by the server, once it is delivered or has failed."""
ACTS = (BEGIN_MAINTENANCE, END_MAINTENANCE, SEND_TEST)

NotificationEndpointKind = TypeAliasType("NotificationEndpointKind", EndpointKind)
DayOfWeekShown = TypeAliasType("DayOfWeekShown", DayOfWeek)
MINUTE_S = 60
MAX_MINUTES = 1440
"""The longest maintenance, a day: a person who needs more begins another."""
_AHEAD = timedelta(days=14)
"""This has two of each day of the week: one may be skipped when the clocks change."""


@dataclass(frozen=True, slots=True)
class NotificationEndpointShown:
    """An address that is notified."""

    key: Annotated[str, Field(description="Identifies it.")]
    kind: NotificationEndpointKind
    address: Annotated[str, Field(description="As people may see it; a URL is not shown.")]
    works: Annotated[
        bool | None, Field(description="Whether the last attempt was delivered; null: there was none.")
    ]
    tried_at: Annotated[InstantObject | None, Field(description="The last attempt; null: there was none.")]
    result: Annotated[MessageObject | None, Field(description="Why that failed; null: no reason.")]
    waiting: Annotated[int, Field(description="Notices that are in no message yet.")]


@dataclass(frozen=True, slots=True)
class NotificationGroup:
    """A group, and its addresses that are on duty now."""

    name: str
    on_duty: Annotated[list[str], Field(description="Addresses.")]
    gaps: Annotated[list[MessageObject], Field(description="When no one is on duty.")]


@dataclass(frozen=True, slots=True)
class RecurringMaintenanceShown:
    """A recurring maintenance of the configuration; times by the clock of the site."""

    days: Annotated[list[DayOfWeekShown], Field(description="On which it begins.")]
    starts: Annotated[str, Field(description="Local time, such as 22:00.")]
    ends: Annotated[str, Field(description="Local time; not after starts: on the next day.")]
    last_day: Annotated[str, Field(description="The last day on which it begins, ISO 8601.")]
    buses: Annotated[list[str], Field(description="Empty: all buses and the server.")]
    reason: str
    present: Annotated[bool, Field(description="Whether it is under way.")]
    since: Annotated[InstantObject | None, Field(description="Of the present or next one; null: no more.")]
    until: Annotated[InstantObject | None, Field(description="Its end, ISO 8601; null: no more.")]


class Maintenance:
    """The maintenance that people begin, and the recurring one of the configuration. ``zone``: of the site,
    whose clock determines the latter; ``buses``: the names of all buses."""

    def __init__(
        self,
        outbox: NotificationOutbox,
        events: EventLog,
        recurring: Sequence[MaintenanceSettings],
        zone: ZoneInfo,
        buses: Sequence[str],
        clock: Clock = unix_now,
    ) -> None:
        self.buses = buses
        self._outbox = outbox
        self._events = events
        self._recurring = recurring
        self._zone = zone
        self._clock = clock
        self._spans_of: tuple[date, list[QuietSpan]] | None = None
        self._rows: list[MaintenanceShown] = []
        """The maintenance of the last months: an alarm's time may count from its end."""

    async def load(self) -> None:
        """Read the stored maintenance."""
        self._rows = await self._outbox.quiet(self._clock())

    def spans(self) -> list[QuietSpan]:
        """Return the times in which nothing is notified."""
        return [*(row.span for row in self._rows), *self._recurring_spans()]

    def recurring(self) -> list[RecurringMaintenanceShown]:
        """Return each recurring maintenance with its present or next span."""
        return [self._shown(each, self._clock()) for each in self._recurring]

    def present(self) -> list[MaintenanceShown]:
        """Return the present maintenance that people began."""
        now = self._clock()
        return [row for row in self._rows if row.since <= now < row.until]

    def _shown(self, recurring: MaintenanceSettings, now: UnixTime) -> RecurringMaintenanceShown:
        day = self._day(now)
        spans = recurring_spans(recurring, day - timedelta(days=1), day + _AHEAD, self._zone)
        span = next((span for span in spans if now < span.ends), None)
        return RecurringMaintenanceShown(
            days=[day for day in DAYS if day in recurring.days],
            starts=recurring.starts,
            ends=recurring.ends,
            last_day=recurring.until.isoformat(),
            buses=list(recurring.buses),
            reason=recurring.reason,
            present=span is not None and span.starts <= now,
            since=None if span is None else span.starts,
            until=None if span is None else span.ends,
        )

    def _recurring_spans(self) -> list[QuietSpan]:
        """Return the spans of the last months, computed once a day, as they are needed each second."""
        day = self._day(self._clock())
        if self._spans_of is None or self._spans_of[0] != day:
            first = day - timedelta(seconds=MAX_AGE_S)
            spans = (recurring_spans(each, first, day, self._zone) for each in self._recurring)
            self._spans_of = day, [span for several in spans for span in several]
        return self._spans_of[1]

    def _day(self, at: UnixTime) -> date:
        return datetime.fromtimestamp(float(at), self._zone).date()

    async def begin(self, person: Person, bus: str | None, minutes: int, reason: str) -> None:
        """Notify nothing of a bus, or of all (None), from now on. Raise Problem 403 or 404."""
        BEGIN_MAINTENANCE.check(person)
        if bus is not None and bus not in self.buses:
            raise unknown_bus(bus, self.buses)
        now = self._clock()
        span = QuietSpan(now, now + minutes * MINUTE_S, bus)
        await self._events.record(
            **BEGIN_MAINTENANCE.by(person, n=minutes),
            bus=bus,
            message=reason,
            also=partial(begin_quiet, span=span, who=person.name, reason=reason),
        )
        await self.load()

    async def end(self, person: Person, id: int) -> None:
        """End a maintenance before its time. Raise Problem 403, or 404 if it is not under way."""
        END_MAINTENANCE.check(person)
        row = next((row for row in self.present() if row.id == id), None)
        if row is None:
            raise Problem(404, "not_found", Message("maintenance_not_present"))
        await self._events.record(
            **END_MAINTENANCE.by(person),
            bus=row.bus,
            message=row.reason,
            also=partial(end_quiet, id=id, now=self._clock()),
        )
        await self.load()


class Notification:
    """The data of notification for pages and the API. ``local_time``: of the site, for duty rosters."""

    def __init__(
        self,
        outbox: NotificationOutbox,
        maintenance: Maintenance,
        dispatcher: Dispatcher,
        links: AcknowledgeLinks,
        local_time: Callable[[], datetime],
    ) -> None:
        self.plan = dispatcher.plan
        self.outbox = outbox
        self.maintenance = maintenance
        self.dispatcher = dispatcher
        self.links = links
        self._local_time = local_time

    async def load(self) -> None:
        """Read the key of links and the maintenance."""
        self.links.key = await self.outbox.link_key()
        await self.maintenance.load()

    async def endpoints(self) -> list[NotificationEndpointShown]:
        """Return each configured address with the result of its last attempt."""
        waiting, found = await self.outbox.waiting(), []
        for key, endpoint in self.plan.endpoints.items():
            last = await self.outbox.last_to(key)
            tried = last if last is not None and last.attempts > 0 else None
            found.append(
                NotificationEndpointShown(
                    key=key,
                    kind=endpoint.kind,
                    address=endpoint.address,
                    works=None if tried is None else tried.state == "delivered",
                    tried_at=None if tried is None else tried.tried_at,
                    result=None if tried is None else tried.result,
                    waiting=waiting.get(key, 0),
                )
            )
        return found

    def groups(self) -> list[NotificationGroup]:
        """Return each configured group, and its addresses that are on duty now."""
        local, plan = self._local_time(), self.plan
        return [NotificationGroup(name, plan.on_duty(name, local), plan.gaps(name)) for name in plan.rosters]

    async def test(self, person: Person, key: str) -> NotificationDelivery | None:
        """Send a test message to the address of a key, as `Dispatcher.test`. Raise Problem 403 or 404."""
        SEND_TEST.check(person)
        endpoint = self.plan.endpoints.get(key)
        if endpoint is None:
            raise Problem(404, "not_found", Message.of("notify_endpoint_unknown", endpoint=key[:200]))
        return await self.dispatcher.test(endpoint)


TICK_S = 1.0
STANDING_AFTER_PASSES = 10
"""By then each alarm's condition has been observed again, if its unit responds."""


class AlarmNotifier:
    """The notifier, which follows each transition of the journal once: one transaction stores that, with the
    results. Call :meth:`load` before the first alarm rises: if notification was never on, it begins with the
    present."""

    def __init__(
        self,
        alarms: LineAlarms,
        outbox: NotificationOutbox,
        maintenance: Maintenance,
        dispatcher: Dispatcher,
        local_time: Callable[[], datetime],
    ) -> None:
        self._alarms = alarms
        self._outbox = outbox
        self._maintenance = maintenance
        self._dispatcher = dispatcher
        self._local_time = local_time
        self._rules = dispatcher.plan.rules
        self._cursor = 0
        self._open: dict[str, Episode] = {}

    async def load(self) -> None:
        """Read the position in the journal at the end of the last run."""
        self._cursor, episodes = await self._outbox.followed()
        self._open = {key: each for key, each in episodes.items() if self._alarms.known(key) is not None}

    async def follow(self) -> None:
        """Follow the journal until canceled."""
        if not self._dispatcher.plan.endpoints:
            await asyncio.Event().wait()
        for passes in count():
            await self.advance()
            if passes == STANDING_AFTER_PASSES:
                await self.notify_standing()
            await asyncio.sleep(TICK_S)

    async def advance(self) -> None:
        """Follow new journal entries, and make the notices that are due now."""
        entries = await self._outbox.journal_after(self._cursor)
        cursor = entries[-1].id if entries else self._cursor
        known = [entry for entry in entries if self._alarms.known(entry.alarm) is not None]
        now = unix_now()
        done = follow(self._open, known, self._rules, self._maintenance.spans(), now, self._local_time())
        if known or done.notices or done.open != self._open:
            await self._save(done, cursor, {entry.id: entry for entry in known}, now)
        self._cursor, self._open = cursor, done.open

    async def notify_standing(self) -> None:
        """Notify addresses of the alarms that wait for their acknowledgement, as far as a rule notifies the
        address by now and it was not notified before. An address may be new in the configuration."""
        waiting = {
            alarm.definition.key: alarm
            for alarm in self._alarms.every()
            if alarm.is_unacknowledged and (alarm.facts.active or alarm.facts.latched)
        }
        episodes = {**await self._outbox.opened(waiting, self._cursor), **self._open}
        quiet, now, local = self._maintenance.spans(), unix_now(), self._local_time()
        followed, items = dict(self._open), []
        for key, alarm in waiting.items():
            episode = episodes.get(key)
            if episode is None or episode.occurrence != alarm.facts.occurrence:
                # The journal does not have the present occurrence yet.
                continue
            found, planned = due(replace(episode, notified_after_s=-1.0), self._rules, quiet, now, local)
            notified_after_s = max(episode.notified_after_s, found.notified_after_s)
            followed[key] = replace(found, notified_after_s=notified_after_s)
            items += [
                replace(self._item(each, None, now), key=f"{STANDING}{episode.entry}") for each in planned
            ]
        await self._outbox.save(self._cursor, followed, (), standing=items)
        self._open = followed
        self._dispatcher.wake()

    async def _save(
        self, done: Followed, cursor: int, entries: dict[int, JournalEntry], now: UnixTime
    ) -> None:
        items = [self._item(each, entries.get(each.episode.entry), now) for each in done.notices]
        cleared = [self._all_clear(entry, now) for entry in done.cleared]
        await self._outbox.save(cursor, done.open, items, cleared)
        if items or cleared:
            self._dispatcher.wake()

    def _item(self, planned: PlannedNotice, entry: JournalEntry | None, now: UnixTime) -> OutboxItem:
        """Return the item of a notice; ``entry``: the transition that has just led to it; if None, the item
        has the alarm as it is now."""
        episode, alarm = planned.episode, self._alarm(planned.episode.alarm)
        notice = notice_of(
            alarm,
            self._place(alarm),
            episode.at,
            alarm.facts.state if entry is None else entry.after,
            episode.occurrence,
            escalated=planned.after_s > 0,
        )
        key = f"alarm:{episode.entry}:{planned.after_s:g}"
        return OutboxItem(key, planned.endpoint, "alarm", now, notice, episode.alarm, episode.occurrence)

    def _all_clear(self, entry: JournalEntry, now: UnixTime) -> OutboxItem:
        alarm = self._alarm(entry.alarm)
        notice = notice_of(alarm, self._place(alarm), entry.at, entry.after, entry.occurrence)
        return OutboxItem(f"clear:{entry.id}", "", "clear", now, notice, entry.alarm, entry.occurrence)

    def _alarm(self, key: str) -> Alarm:
        alarm = self._alarms.known(key)
        assert alarm is not None
        return alarm

    def _place(self, alarm: Alarm) -> str:
        definition = alarm.definition
        return "" if definition.bus is None else self._alarms.buses[definition.bus].place(definition.unit)

"""Follows the journal of alarms and puts what is to be notified into the outbox."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from itertools import count

from app.line.alarms.alarm import Alarm
from app.line.alarms.journal import JournalEntry
from app.line.alarms.line_alarms import LineAlarms
from app.records.notification.dispatcher import Dispatcher
from app.records.notification.outbox import STANDING, NotificationOutbox, OutboxItem, notice_of
from app.records.notification.rules import Episode, Followed, PlannedNotice, due, follow
from app.records.notification.service import Maintenance
from bus.instants import Clock, UnixTime, unix_now

TICK_S = 1.0
STANDING_AFTER_PASSES = 10
"""By then the condition of each alarm was observed again, where its unit responds."""


class AlarmNotifier:
    """Follows each transition of the journal once: what it led to, and that it was followed, is stored in one
    transaction. Call :meth:`load` before the first alarm rises: notification that was never on begins with
    the present."""

    def __init__(
        self,
        alarms: LineAlarms,
        outbox: NotificationOutbox,
        maintenance: Maintenance,
        dispatcher: Dispatcher,
        local_time: Callable[[], datetime],
        clock: Clock = unix_now,
    ) -> None:
        self._alarms = alarms
        self._outbox = outbox
        self._maintenance = maintenance
        self._dispatcher = dispatcher
        self._local_time = local_time
        self._clock = clock
        self._rules = dispatcher.plan.rules
        self._cursor = 0
        self._open: dict[str, Episode] = {}

    async def load(self) -> None:
        """Read how far the last run has followed the journal."""
        self._cursor, episodes = await self._outbox.followed()
        self._open = {key: each for key, each in episodes.items() if self._alarms.known(key) is not None}

    async def follow(self) -> None:
        """Follow the journal without end."""
        if not self._dispatcher.plan.endpoints:
            await asyncio.Event().wait()
        for passes in count():
            await self.advance()
            if passes == STANDING_AFTER_PASSES:
                await self.notify_standing()
            await asyncio.sleep(TICK_S)

    async def advance(self) -> None:
        """Follow what is new in the journal, and what is due by now."""
        entries = await self._outbox.journal_after(self._cursor)
        cursor = entries[-1].id if entries else self._cursor
        known = [entry for entry in entries if self._alarms.known(entry.alarm) is not None]
        now = self._clock()
        done = follow(self._open, known, self._rules, self._maintenance.spans(), now, self._local_time())
        if known or done.notices or done.open != self._open:
            await self._save(done, cursor, {entry.id: entry for entry in known}, now)
        self._cursor, self._open = cursor, done.open

    async def notify_standing(self) -> None:
        """Notify each address that a rule notifies by now of the alarms that wait for their acknowledgement,
        but for those that it was notified of. An address may be new in the configuration."""
        waiting = {
            alarm.definition.key: alarm
            for alarm in self._alarms.every()
            if alarm.is_unacknowledged and (alarm.facts.active or alarm.facts.latched)
        }
        episodes = {**await self._outbox.opened(waiting, self._cursor), **self._open}
        quiet, now, local = self._maintenance.spans(), self._clock(), self._local_time()
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
        """Make the item of a notice; ``entry``: the transition that has just led to it, else the alarm is
        notified as it is by now."""
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

"""Follows the alarm journal of one bus, or of the site, and puts what is to be notified into the outbox."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from itertools import count

from app.line.alarms.alarm import SITE
from app.line.alarms.alarm_list import AlarmList
from app.line.alarms.journal import JournalEntry
from app.records.notification.notice import OutboxItem, notice_of
from app.records.notification.outbox import STANDING
from app.records.notification.rules.notices import Episode, Followed, PlannedNotice, due, follow
from app.records.notification.service import Notification
from bus.instants import UnixTime

TICK_S = 1.0
STANDING_AFTER_PASSES = 10
"""By then the condition of each alarm was observed again, where its unit responds."""


class AlarmNotifier:
    """Each transition of the journal is followed once: how far, and what it has led to, is one transaction.
    ``bus``: None for the alarms of the site; ``place``: the name of a unit of the bus."""

    def __init__(
        self,
        notification: Notification,
        bus: str | None,
        alarms: AlarmList,
        place: Callable[[int | None], str],
    ) -> None:
        self._notification = notification
        self._store = notification.store
        self._rules = notification.plan.rules
        self._bus = bus
        self._source = SITE if bus is None else bus
        self._alarms = alarms.known
        self._place = place
        self._cursor = 0
        self._open: dict[str, Episode] = {}

    async def follow(self) -> None:
        """Follow the journal without end. Call :meth:`load` first: notification that was never on begins with
        the present, so an alarm that rises before it would be passed over."""
        if not self._notification.plan.endpoints:
            await asyncio.Event().wait()
        for passes in count():
            await self.advance()
            if passes == STANDING_AFTER_PASSES:
                await self.notify_standing()
            await asyncio.sleep(TICK_S)

    async def load(self) -> None:
        """Read how far the last run has followed the journal; once at start."""
        self._cursor, episodes = await self._store.load(self._source)
        self._open = {key: each for key, each in episodes.items() if key in self._alarms}

    async def advance(self) -> None:
        """Take in what the journal has, and what is due by now."""
        entries, cursor = await self._store.journal_after(self._bus, self._cursor)
        known = [entry for entry in entries if entry.alarm in self._alarms]
        quiet, now, local = self._notification.present()
        done = follow(self._open, known, self._rules, quiet, now, local)
        if known or done.notices or done.open != self._open:
            await self._save(done, cursor, {entry.id: entry for entry in known}, now)
        self._cursor, self._open = cursor, done.open

    async def notify_standing(self) -> None:
        """Once after a start: each address that a rule notifies by now learns of the alarms that wait for
        their acknowledgement, but for those that it was notified of. It may be new in the configuration."""
        waiting = [
            key
            for key, alarm in self._alarms.items()
            if alarm.is_unacknowledged and (alarm.facts.active or alarm.facts.latched)
        ]
        episodes = {**await self._store.opened(waiting, self._cursor), **self._open}
        quiet, now, local = self._notification.present()
        followed, items = dict(self._open), []
        for episode in (episodes[key] for key in waiting if key in episodes):
            if episode.occurrence != self._alarms[episode.alarm].facts.occurrence:
                # The journal does not have the present one yet.
                continue
            found, planned = due(replace(episode, notified_after_s=-1.0), self._rules, quiet, now, local)
            notified_after_s = max(episode.notified_after_s, found.notified_after_s)
            followed[episode.alarm] = replace(found, notified_after_s=notified_after_s)
            items += [
                replace(self._item(each, None, now), key=f"{STANDING}{episode.entry}") for each in planned
            ]
        await self._store.save(self._source, self._cursor, followed, (), (), items)
        self._open = followed
        self._notification.dispatcher.wake()

    async def _save(
        self, done: Followed, cursor: int, entries: dict[int, JournalEntry], now: UnixTime
    ) -> None:
        items = [self._item(each, entries.get(each.episode.entry), now) for each in done.notices]
        cleared = [self._all_clear(entry, now) for entry in done.cleared]
        await self._store.save(self._source, cursor, done.open, items, cleared)
        if items or cleared:
            self._notification.dispatcher.wake()

    def _item(self, planned: PlannedNotice, entry: JournalEntry | None, now: UnixTime) -> OutboxItem:
        """``entry``: where it has just been made; else the alarm is as it is by now."""
        episode, alarm = planned.episode, self._alarms[planned.episode.alarm]
        state = alarm.facts.state if entry is None else entry.after
        notice = notice_of(
            alarm,
            self._place(alarm.definition.unit),
            episode.at,
            state,
            episode.occurrence,
            escalated=planned.after_s > 0,
        )
        key = f"alarm:{episode.entry}:{planned.after_s:g}"
        return OutboxItem(key, planned.endpoint, "alarm", now, notice, episode.alarm, episode.occurrence)

    def _all_clear(self, entry: JournalEntry, now: UnixTime) -> OutboxItem:
        alarm = self._alarms[entry.alarm]
        notice = notice_of(alarm, self._place(alarm.definition.unit), entry.at, entry.after, entry.occurrence)
        return OutboxItem(f"clear:{entry.id}", "", "clear", now, notice, entry.alarm, entry.occurrence)

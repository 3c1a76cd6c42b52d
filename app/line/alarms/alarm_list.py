"""The list of alarms of one bus or of the site, which applies the rules, writes every change in order and
tells subscribers; and the changes of one act of a person."""

from __future__ import annotations

import asyncio
from collections import ChainMap, Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial

import structlog
from typing_extensions import Unpack

from app.core.database import StoreConnection
from app.errors import StoreError
from app.line.alarms import rules
from app.line.alarms.alarm import SITE, Alarm, AlarmDefinition
from app.line.alarms.journal import AlarmStore, JournalEntry, StoredAlarm, alarm_writer, entry_of
from app.line.alarms.performance import ObservedSpan, observed_until
from app.line.alarms.rules import AlarmFacts, Changed, FirstOut, due_at, shifted
from app.line.conditions.condition import AlarmPriority
from app.people.audit.entry import EventKind
from app.people.audit.log import Also, EventFields, EventLog
from bus.instants import Clock, UnixTime

RETRY_AFTER_S = 1.0
TICK_S = 1.0
OBSERVED_EVERY_S = 60.0
"""The seconds between two notes in the store that the alarms are still observed."""
MAX_WITHDRAWN = 500
"""The most alarms without a definition that are kept for those who follow the journal."""
AlarmSubscriber = Callable[[Alarm], None]
"""A function that is called with an alarm after it has changed."""
log = structlog.get_logger()


class AlarmList:
    """The alarms of one bus or of the site. A change holds at once; the journal has it a moment later, in
    order, and waits if the store cannot be written."""

    def __init__(
        self, definitions: Iterable[AlarmDefinition], store: AlarmStore, bus: str | None = None
    ) -> None:
        self.alarms = {definition.key: Alarm(definition) for definition in definitions}
        self._withdrawn: dict[str, Alarm] = {}
        self.known: Mapping[str, Alarm] = ChainMap(self.alarms, self._withdrawn)
        """The alarms, and those whose definition has ended: followers of the journal may be a moment late."""
        self._place = bus or SITE
        self._store = store
        self._entries: list[JournalEntry] = []
        self._changed: dict[str, Alarm] = {}
        self._due: dict[str, UnixTime] = {}
        self._wake = asyncio.Event()
        self.writing = asyncio.Lock()
        """Held while transitions are written: transitions that could not be written must not come after later
        ones."""
        self._first_out = FirstOut()
        self._subscribers: list[AlarmSubscriber] = []
        self.annunciated: Counter[AlarmPriority] = Counter()
        """The number of alarms annunciated since the server started."""
        self.observed: ObservedSpan | None = None
        """The span up to now in which the conditions were observed without a gap; None before it begins."""
        self._recorded: ObservedSpan | None = None

    def subscribe(self, subscriber: AlarmSubscriber) -> None:
        """Call ``subscriber`` with each alarm that has changed."""
        self._subscribers.append(subscriber)

    def load(self, stored: Mapping[str, StoredAlarm], now: UnixTime) -> None:
        """Continue from the states that the last run left. Whether an active alarm still holds is not known
        until its condition is observed."""
        for key, kept in stored.items():
            alarm = self.alarms.get(key)
            if alarm is None:
                continue
            unknown_since = now if kept.facts.active else None
            alarm.facts = replace(kept.facts, unknown_since=unknown_since)
            alarm.first_out, alarm.hidden_by, alarm.reason = kept.first_out, kept.hidden_by, kept.reason
            self._schedule(alarm)

    def add(self, alarm: Alarm) -> None:
        """Add an alarm, or replace it by one with another definition."""
        self.alarms[alarm.definition.key] = alarm
        self._withdrawn.pop(alarm.definition.key, None)
        self._schedule(alarm)

    def remove(self, key: str) -> None:
        """Remove an alarm whose definition has ended, and which is normal."""
        self._due.pop(key, None)
        self._withdrawn[key] = self.alarms.pop(key)
        if len(self._withdrawn) > MAX_WITHDRAWN:
            del self._withdrawn[next(iter(self._withdrawn))]

    # --- changes of an alarm --------------------------------------------------------------------------

    def observe(self, alarm: Alarm, holds: bool | None, now: UnixTime) -> None:
        """Set whether the condition of an alarm holds; ``None``: it is not known."""
        if holds is alarm.holds:
            return
        alarm.holds = holds
        self.apply(alarm, rules.observe(alarm.facts, alarm.definition.attributes, holds, now))

    def suppress(self, alarm: Alarm, suppressed: bool, now: UnixTime) -> None:
        """Begin or end the suppression of an alarm by design."""
        if suppressed is not alarm.facts.suppressed:
            self.apply(alarm, rules.suppress(alarm.facts, suppressed, now))

    def restore(
        self, alarm: Alarm, facts: AlarmFacts, hidden_by: str, reason: str, *, unless_changed_from: AlarmFacts
    ) -> None:
        """Undo a person's act that the audit log could not record, unless the alarm has changed since."""
        if alarm.facts is not unless_changed_from:
            return
        alarm.facts, alarm.hidden_by, alarm.reason = facts, hidden_by, reason
        self._schedule(alarm)
        self._has_changed(alarm)

    def advance(self, now: UnixTime) -> None:
        """Apply the transitions that are due by time alone."""
        for key in [key for key, due in self._due.items() if due <= now]:
            alarm = self.alarms[key]
            self.apply(alarm, rules.advance(alarm.facts, alarm.definition.attributes, now))

    def clock_stepped(self, step_s: float) -> None:
        """Shift every running time with a clock that was set, so that it keeps its distance from now."""
        for key, alarm in self.alarms.items():
            facts = shifted(alarm.facts, step_s)
            if facts != alarm.facts:
                alarm.facts = facts
                self._schedule(alarm)
                self._changed[key] = alarm
        self._wake.set()

    def apply(self, alarm: Alarm, changed: Changed, who: str = "", reason: str = "") -> None:
        """Change an alarm as the rules found; ``who``: the person who acted."""
        was_unknown = alarm.facts.unknown_since is not None
        alarm.facts, transitions = changed
        self._schedule(alarm)
        for each in transitions:
            self._entries.append(entry_of(alarm.definition, each, who, reason))
            if each.after == "unack_active" != each.before:
                self.annunciated[alarm.definition.priority] += 1
            if each.trigger == "rise":
                alarm.first_out = 0
                if not alarm.facts.is_hidden and alarm.definition.about != "parameters":
                    self._mark_first_out(alarm, each.at)
        if transitions:
            self._has_changed(alarm)
        elif alarm.facts.active and was_unknown != (alarm.facts.unknown_since is not None):
            self._publish(alarm)

    def _mark_first_out(self, alarm: Alarm, at: UnixTime) -> None:
        key, count = self._first_out.rise(alarm.definition.key, at)
        first = self.alarms.get(key)
        if first is not None and count > max(first.first_out, 1):
            first.first_out = count
            self._has_changed(first)

    def _schedule(self, alarm: Alarm) -> None:
        key, due = alarm.definition.key, due_at(alarm.facts, alarm.definition.attributes)
        if due is not None:
            self._due[key] = due
            self._wake.set()
        else:
            self._due.pop(key, None)

    def _has_changed(self, alarm: Alarm) -> None:
        self._changed[alarm.definition.key] = alarm
        self._wake.set()
        self._publish(alarm)

    def _publish(self, alarm: Alarm) -> None:
        for subscriber in self._subscribers:
            subscriber(alarm)

    # --- the journal ----------------------------------------------------------------------------------

    def pop_unwritten(self) -> tuple[list[JournalEntry], list[Alarm]]:
        """Return everything that is not on disk yet; the caller writes it, or calls `requeue`."""
        entries, alarms = self._entries, list(self._changed.values())
        self._entries, self._changed = [], {}
        return entries, alarms

    def requeue(self, entries: list[JournalEntry], alarms: list[Alarm]) -> None:
        """Queue again what could not be written, before what has changed since."""
        self._entries = entries + self._entries
        self._changed = {alarm.definition.key: alarm for alarm in alarms} | self._changed

    async def write(self) -> None:
        """Write everything that is not on disk yet. Raise StoreError; the changes then wait."""
        async with self.writing:
            entries, alarms = self.pop_unwritten()
            if not entries and not alarms:
                return
            try:
                # The end of the server cancels this wait, but must not cancel the write.
                await asyncio.shield(self._store.write(entries, alarms))
            except StoreError:
                self.requeue(entries, alarms)
                raise

    async def record_observed(self) -> None:
        """Store until when the alarms were observed. Raise StoreError."""
        if self.observed is not None:
            await self._store.write_observed(self._place, self.observed)
            self._recorded = self.observed

    def _is_observed_longer(self) -> bool:
        """Return whether the store has to learn until when the alarms were observed."""
        if self.observed is None or self._recorded is None:
            return self.observed is not None
        is_new_span = self.observed.start != self._recorded.start
        return is_new_span or self.observed.end - self._recorded.end >= OBSERVED_EVERY_S

    async def follow(self, tick: Callable[[], None], clock: Clock) -> None:
        """Call ``tick`` every second, apply what is due at its time, and write what has changed, until
        canceled."""
        fault, ticked_at = "", UnixTime(0.0)
        while True:
            now = clock()
            if not 0 <= now - ticked_at < TICK_S:
                ticked_at = now
                self.observed = observed_until(now, self.observed)
                tick()
            self.advance(now)
            try:
                await self.write()
                if self._is_observed_longer():
                    await self.record_observed()
                fault = ""
            except StoreError as error:
                if str(error) != fault:
                    log.error("alarm transitions wait", error=str(error))
                fault = str(error)
                await asyncio.sleep(RETRY_AFTER_S)
            await self._wait(ticked_at + TICK_S, clock())

    async def _wait(self, until: UnixTime, now: UnixTime) -> None:
        """Wait until something has changed or is due, at most until ``until``."""
        due = min((until, *self._due.values()))
        with suppress(TimeoutError):
            async with asyncio.timeout(max(0.0, due - now)):
                await self._wake.wait()
        self._wake.clear()


class ActTransaction:
    """The changes of one act of a person to alarms of ``lists``. The caller holds ``writing`` of each list
    until they are recorded."""

    def __init__(self, who: str, lists: Iterable[AlarmList]) -> None:
        self._who = who
        self._lists = tuple(lists)
        self._undo: list[Callable[[], None]] = []
        self.alarms: list[Alarm] = []
        """The alarms that were changed."""

    def change(
        self, of: AlarmList, alarm: Alarm, changed: Changed, reason: str = "", *, hides: bool = False
    ) -> None:
        """Change an alarm of a list. An act that ``hides`` the alarm stores there who hid it and why."""
        before = (alarm.facts, alarm.hidden_by, alarm.reason)
        if hides:
            alarm.hidden_by, alarm.reason = self._who, reason
        of.apply(alarm, changed, self._who, reason)
        self._undo.append(partial(of.restore, alarm, *before, unless_changed_from=alarm.facts))
        self.alarms.append(alarm)

    async def record(
        self,
        events: EventLog,
        *beside: Also,
        kind: EventKind,
        **fields: Unpack[EventFields],
    ) -> None:
        """Record the act in the audit log, together with the journal and what is written ``beside`` it.
        Raise StoreError; every alarm is then as before, unless it has changed since."""
        taken = [(each, *each.pop_unwritten()) for each in self._lists]
        written = [*beside, *(alarm_writer(entries, alarms) for _, entries, alarms in taken)]

        def write(connection: StoreConnection) -> None:
            for each in written:
                each(connection)

        try:
            await events.record(kind=kind, **fields, also=write)
        except StoreError:
            for each, entries, alarms in taken:
                each.requeue([entry for entry in entries if entry.who != self._who], alarms)
            for undo in self._undo:
                undo()
            raise

"""The site's own alarms: those of the configuration, and those that engineers add, change and remove."""

from __future__ import annotations

import asyncio
import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import structlog

from app.alarms.alarm import Alarm
from app.alarms.bus_alarms import BusAlarms
from app.alarms.definition import own_key
from app.alarms.line_alarms import LineAlarms
from app.alarms.own import own_definition
from app.alarms.own_store import OwnAlarmRow, OwnAlarmStore, OwnAlarmWriting
from app.alarms.rules import changes
from app.alarms.settings import AlarmSettings
from app.alarms.simulation.proposal import in_toml, proposed
from app.alarms.store import JournalWriting
from app.audit.log import Also, EventLog
from app.errors import Problem, StoreError
from app.settings import Settings
from app.web.access import Person
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

MAX_OWN = 500
"""Alarms that are added on the page."""
log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class OwnAlarm:
    """One that was added on the page; ``request``: who added it, with the Idempotency-Key."""

    key: str
    settings: AlarmSettings
    version: int
    who: str
    at: UnixTime
    request: str


@dataclass(frozen=True, slots=True)
class LeftAside:
    """One that does not fit the configuration. It is not observed; ``why`` states the reason."""

    key: str
    name: str
    version: int
    why: Message


class OwnAlarmBook:
    """One for the app. An act is in the audit log, the journal, the store and the engine together, or
    nowhere. Call :meth:`load` before the alarms take up their states."""

    def __init__(
        self,
        settings: Settings,
        alarms: LineAlarms,
        store: OwnAlarmStore,
        events: EventLog,
        clock: Clock = unix_now,
    ) -> None:
        self.configured = {own_key(each.bus, each.unit, each.name): each for each in settings.alarm}
        self.added: dict[str, OwnAlarm] = {}
        self.left_aside: dict[str, LeftAside] = {}
        self._bus_settings = settings.bus
        self._alarms = alarms
        self._store = store
        self._events = events
        self._clock = clock
        self._acting = asyncio.Lock()
        """One act at a time: names and their number are checked before what is stored."""

    async def load(self) -> None:
        """Observe what is stored and fits; once at start."""
        for row in await self._store.load():
            name = row.alarm
            try:
                written = json.loads(row.settings)
                name = str(written.get("name", name))
                settings = self._fitting(written)
            except (ValueError, AttributeError):
                self._leave_aside(row, name, Message("own_alarm_unreadable"))
            except Problem as problem:
                self._leave_aside(row, name, problem.message)
            else:
                self._bus(settings).add_own(settings, Alarm(own_definition(settings)))
                self._keep(row, settings, row.version)

    def _leave_aside(self, row: OwnAlarmRow, name: str, why: Message) -> None:
        log.warning("alarm of the site does not fit the configuration", alarm=name, why=str(why))
        self.left_aside[row.alarm] = LeftAside(row.alarm, name, row.version, why)

    def _keep(self, row: OwnAlarmRow, settings: AlarmSettings, version: int) -> OwnAlarm:
        own = OwnAlarm(row.alarm, settings, version, row.who, row.changed_at, row.request)
        self.added[row.alarm] = own
        return own

    def _fitting(self, written: Mapping[str, Any]) -> AlarmSettings:
        """Raises Problem 422, or 409 where its name is taken."""
        settings = proposed(written, self._bus_settings)
        every = [*self.configured.values(), *(own.settings for own in self.added.values())]
        if (settings.bus, settings.name) in {(each.bus, each.name) for each in every}:
            raise Problem(409, "taken", Message.of("own_alarm_taken", name=settings.name, bus=settings.bus))
        return settings

    async def add(
        self, person: Person, written: Mapping[str, Any], key_of_request: str | None = None
    ) -> OwnAlarm:
        """Observe another alarm from the next reading on. The same request adds it once. Raises Problem."""
        request = f"{person.account}:{key_of_request}" if key_of_request else ""
        async with self._acting:
            earlier = next((own for own in self.added.values() if request and own.request == request), None)
            if earlier is not None:
                return self._repeated(earlier, written)
            settings = self._fitting(written)
            key = own_key(settings.bus, settings.unit, settings.name)
            if len(self.added) + len(self.left_aside) >= MAX_OWN:
                raise Problem(409, "too_many", Message.of("own_alarms_full", n=MAX_OWN))
            bus, alarm = self._bus(settings), Alarm(own_definition(settings))
            stored = await self._alarms.store.find(key)
            row = self._row(person, settings, request)
            writing = OwnAlarmWriting(key, row)
            what = Message.of("event_own_alarm_added", name=settings.name)
            await self._record(person, settings, what, None, in_words(settings), "", writing)
            self.left_aside.pop(key, None)
            bus.add_own(settings, alarm)
            if stored is not None:
                bus.list.load({key: stored}, self._clock())
            return self._keep(row, settings, writing.version)

    def _repeated(self, earlier: OwnAlarm, written: Mapping[str, Any]) -> OwnAlarm:
        if proposed(written, self._bus_settings) != earlier.settings:
            raise Problem(422, "invalid", Message("own_alarm_key_of_other"))
        return earlier

    async def change(
        self, person: Person, key: str, version: int, written: Mapping[str, Any], reason: str = ""
    ) -> OwnAlarm:
        """Another definition under the same name and unit. The alarm ends; it comes again by the next reading
        where that fulfills the new one. ``version``: of what was changed. Raises Problem."""
        async with self._acting:
            own = self._of_version(key, version)
            settings = proposed(written, self._bus_settings)
            if own_key(settings.bus, settings.unit, settings.name) != key:
                raise Problem(422, "invalid", Message.of("own_alarm_other_place", name=own.settings.name))
            row = self._row(person, settings, own.request)
            writing = OwnAlarmWriting(key, row)
            what = Message.of("event_own_alarm_changed", name=settings.name)
            alarm = await self._end(person, own, what, in_words(settings), reason, writing)
            after = Alarm(own_definition(settings), alarm.facts)
            self._bus(settings).add_own(settings, after)
            return self._keep(row, settings, writing.version)

    async def remove(self, person: Person, key: str, version: int, reason: str) -> None:
        """End an alarm and its definition. Raises Problem."""
        async with self._acting:
            aside = self.left_aside.get(key)
            if aside is not None and aside.version == version:
                await self._remove_aside(person, aside, reason)
                return
            own = self._of_version(key, version)
            what = Message.of("event_own_alarm_removed", name=own.settings.name)
            await self._end(person, own, what, None, reason, OwnAlarmWriting(key, None))
            self._bus(own.settings).list.take_out(key)
            del self.added[key]

    async def _remove_aside(self, person: Person, aside: LeftAside, reason: str) -> None:
        await self._events.record(
            kind="alarm",
            **person.author,
            what=Message.of("event_own_alarm_removed", name=aside.name),
            message=reason,
            also=OwnAlarmWriting(aside.key, None),
        )
        del self.left_aside[aside.key]

    def _of_version(self, key: str, version: int) -> OwnAlarm:
        own = self.added.get(key)
        if own is None and key in self.configured:
            raise Problem(409, "taken", Message.of("own_alarm_configured", name=self.configured[key].name))
        if own is None and key not in self.left_aside:
            raise Problem(404, "unknown_alarm", Message.of("alarm_unknown", id=key[:200]))
        if own is None or own.version != version:
            name = self.left_aside[key].name if own is None else own.settings.name
            raise Problem(409, "superseded", Message.of("own_alarm_superseded", name=name), id=key)
        return own

    async def _end(
        self,
        person: Person,
        own: OwnAlarm,
        what: Message,
        new: str | None,
        reason: str,
        writing: OwnAlarmWriting,
    ) -> Alarm:
        bus = self._bus(own.settings)
        async with bus.list.writing:
            alarm = bus.list.alarms[own.key]
            now = self._clock()
            bus.list.advance(now)
            before = (alarm.facts, alarm.hidden_by, alarm.reason)
            bus.end_own(alarm)
            changed = changes.withdraw(alarm.facts, alarm.definition.attributes, now)
            bus.list.change(alarm, changed, person.name, reason)
            entries, alarms = bus.list.take_unwritten()
            journal = JournalWriting(entries, alarms)

            def write(connection: sqlite3.Connection) -> None:
                journal(connection)
                writing(connection)

            try:
                await self._record(person, own.settings, what, in_words(own.settings), new, reason, write)
            except StoreError:
                bus.list.give_back([entry for entry in entries if entry.who != person.name], alarms)
                facts, alarm.hidden_by, alarm.reason = before
                bus.list.restore(alarm, facts)
                bus.add_own(own.settings, alarm)
                raise
        return alarm

    async def _record(
        self,
        person: Person,
        settings: AlarmSettings,
        what: Message,
        old: str | None,
        new: str | None,
        reason: str,
        also: Also,
    ) -> None:
        await self._events.record(
            kind="alarm",
            **person.author,
            bus=settings.bus,
            unit=settings.unit,
            what=what,
            old=old,
            new=new,
            message=reason,
            also=also,
        )

    def _row(self, person: Person, settings: AlarmSettings, request: str) -> OwnAlarmRow:
        key = own_key(settings.bus, settings.unit, settings.name)
        written = settings.model_dump_json(exclude_defaults=True)
        return OwnAlarmRow(key, written, person.name, self._clock(), request)

    def _bus(self, settings: AlarmSettings) -> BusAlarms:
        return self._alarms.buses[settings.bus]


def in_words(settings: AlarmSettings) -> str:
    """A definition in one line of the audit log, with the keys of ``[[alarm]]``."""
    return "; ".join(in_toml(settings).splitlines()[1:])

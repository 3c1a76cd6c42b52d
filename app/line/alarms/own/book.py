"""The site's own alarms: those of the configuration, and those that engineers add, change and remove."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import structlog
from pydantic import Field

from app.core.database import Database, StoreConnection, StoreRow
from app.core.web.admission.access import Person
from app.core.web.api.shape import MessageObject
from app.errors import Problem, StoreError
from app.line.alarms.acts import ADD_OWN, CHANGE_OWN, REMOVE_OWN
from app.line.alarms.alarm import Alarm, own_key
from app.line.alarms.monitor.alarm_list import ActTransaction
from app.line.alarms.monitor.bus_alarms import BusAlarms
from app.line.alarms.monitor.line_alarms import LineAlarms
from app.line.alarms.own.definition import in_toml, own_definition, proposed
from app.line.alarms.rules import state_machine
from app.line.alarms.settings import AlarmSettings
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from app.settings import Settings
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

MAX_OWN = 500
"""Alarms that are added on the page."""
log = structlog.get_logger()


@dataclass(slots=True)
class OwnAlarm:
    """An alarm that was added on the page; ``request``: who added it, with the Idempotency-Key."""

    settings: AlarmSettings
    who: str
    at: UnixTime
    request: str
    version: int = 0

    @property
    def key(self) -> str:
        return own_key(self.settings.bus, self.settings.unit, self.settings.name)


@dataclass(frozen=True, slots=True)
class OwnAlarmLeftAside:
    """One that does not fit the configuration; it is not observed."""

    id: str
    name: str
    version: int
    reason: Annotated[MessageObject, Field(description="Why.")]


class OwnAlarmBook:
    """The alarms of the site, configured and added. An act is in the audit log, the journal, the store and
    the engine together, or nowhere. Call :meth:`load` before the alarms take up their states."""

    def __init__(
        self,
        settings: Settings,
        alarms: LineAlarms,
        database: Database,
        events: EventLog,
        clock: Clock = unix_now,
    ) -> None:
        self.configured = {own_key(each.bus, each.unit, each.name): each for each in settings.alarm}
        self.added: dict[str, OwnAlarm] = {}
        self.left_aside: dict[str, OwnAlarmLeftAside] = {}
        self._bus_settings = settings.bus
        self._alarms = alarms
        self._database = database
        self._events = events
        self._clock = clock
        self._acting = asyncio.Lock()
        """One act at a time: names and their number are checked before what is stored."""

    async def load(self) -> None:
        """Observe what is stored and fits the configuration, and note what does not."""
        for row in await self._database.read(_stored):
            name = row["alarm"]
            try:
                written = json.loads(row["settings"])
                name = str(written.get("name", name))
                settings = self._fitting(written)
            except (ValueError, AttributeError):
                self._leave_aside(row, name, Message("own_alarm_unreadable"))
            except Problem as problem:
                self._leave_aside(row, name, problem.message)
            else:
                self._bus(settings).add_own(settings, Alarm(own_definition(settings)))
                own = OwnAlarm(settings, row["who"], row["changed_at"], row["request"], row["version"])
                self.added[own.key] = own

    def _leave_aside(self, row: StoreRow, name: str, why: Message) -> None:
        log.warning("alarm of the site does not fit the configuration", alarm=name, why=str(why))
        self.left_aside[row["alarm"]] = OwnAlarmLeftAside(row["alarm"], name, row["version"], why)

    def every(self) -> list[tuple[AlarmSettings, OwnAlarm | None]]:
        """Return all that are observed; those of the configuration without what was added."""
        configured = [(settings, None) for settings in self.configured.values()]
        added = [(own.settings, own) for own in self.added.values()]
        return [*configured, *added]

    def _fitting(self, written: Mapping[str, Any]) -> AlarmSettings:
        """Raises Problem 422, or 409 where its name is taken."""
        settings = proposed(written, self._bus_settings)
        if (settings.bus, settings.name) in {(each.bus, each.name) for each, _ in self.every()}:
            raise Problem(409, "taken", Message.of("own_alarm_taken", name=settings.name, bus=settings.bus))
        return settings

    async def add(
        self, person: Person, written: Mapping[str, Any], key_of_request: str | None = None
    ) -> OwnAlarm:
        """Observe another alarm from the next reading on. The same request adds it once. Raises Problem."""
        ADD_OWN.check(person)
        request = f"{person.account}:{key_of_request}" if key_of_request else ""
        async with self._acting:
            earlier = next((own for own in self.added.values() if request and own.request == request), None)
            if earlier is not None:
                return self._repeated(earlier, written)
            own = OwnAlarm(self._fitting(written), person.name, self._clock(), request)
            if len(self.added) + len(self.left_aside) >= MAX_OWN:
                raise Problem(409, "too_many", Message.of("own_alarms_full", n=MAX_OWN))
            bus, settings = self._bus(own.settings), own.settings
            stored = await self._alarms.store.find(own.key)
            writing = partial(_replace, key=own.key, own=own)
            performed = ADD_OWN.by(person, name=settings.name)
            await self._events.record(
                **performed, bus=settings.bus, unit=settings.unit, new=in_words(settings), also=writing
            )
            self.left_aside.pop(own.key, None)
            bus.add_own(settings, Alarm(own_definition(settings)))
            if stored is not None:
                bus.list.load({own.key: stored}, self._clock())
            self.added[own.key] = own
            return own

    def _repeated(self, earlier: OwnAlarm, written: Mapping[str, Any]) -> OwnAlarm:
        if proposed(written, self._bus_settings) != earlier.settings:
            raise Problem(422, "invalid", Message("own_alarm_key_of_other"))
        return earlier

    async def change(
        self, person: Person, key: str, version: int, written: Mapping[str, Any], reason: str = ""
    ) -> OwnAlarm:
        """Another definition under the same name and unit. The alarm ends; it comes again by the next reading
        where that fulfills the new one. ``version``: of what was changed. Raises Problem."""
        CHANGE_OWN.check(person)
        async with self._acting:
            former = self._of_version(key, version)
            settings = proposed(written, self._bus_settings)
            own = OwnAlarm(settings, person.name, self._clock(), former.request)
            if own.key != key:
                raise Problem(422, "invalid", Message.of("own_alarm_other_place", name=former.settings.name))
            alarm = await self._end(person, CHANGE_OWN, former, reason, own)
            self._bus(settings).add_own(settings, Alarm(own_definition(settings), alarm.facts))
            self.added[key] = own
            return own

    async def remove(self, person: Person, key: str, version: int, reason: str) -> None:
        """End an alarm and its definition. Raises Problem."""
        REMOVE_OWN.check(person)
        async with self._acting:
            aside = self.left_aside.get(key)
            if aside is not None and aside.version == version:
                await self._events.record(
                    **REMOVE_OWN.by(person, name=aside.name),
                    message=reason,
                    also=partial(_replace, key=key),
                )
                del self.left_aside[key]
                return
            own = self._of_version(key, version)
            await self._end(person, REMOVE_OWN, own, reason)
            self._bus(own.settings).list.take_out(key)
            del self.added[key]

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
        self, person: Person, act: Act, own: OwnAlarm, reason: str, following: OwnAlarm | None = None
    ) -> Alarm:
        bus = self._bus(own.settings)
        async with bus.list.writing:
            alarm, now = bus.list.alarms[own.key], self._clock()
            bus.list.advance(now)
            bus.end_own(alarm)
            transaction = ActTransaction(person.name, [bus.list])
            ended = state_machine.withdraw(alarm.facts, alarm.definition.attributes, now)
            transaction.change(bus.list, alarm, ended, reason)
            try:
                await transaction.record(
                    self._events,
                    partial(_replace, key=own.key, own=following),
                    **act.by(person, name=own.settings.name),
                    bus=own.settings.bus,
                    unit=own.settings.unit,
                    old=in_words(own.settings),
                    new=in_words(following.settings) if following else None,
                    message=reason,
                )
            except StoreError:
                bus.add_own(own.settings, alarm)
                raise
        return alarm

    def _bus(self, settings: AlarmSettings) -> BusAlarms:
        return self._alarms.buses[settings.bus]


def _stored(connection: StoreConnection) -> list[StoreRow]:
    query = "SELECT alarm, settings, who, changed_at, request, version FROM own_alarm ORDER BY alarm"
    return connection.execute(query).fetchall()


def _replace(connection: StoreConnection, key: str, own: OwnAlarm | None = None) -> None:
    """Remove the row of ``key``, then add ``own``, which has its version afterwards; no version is used
    twice."""
    connection.execute("DELETE FROM own_alarm WHERE alarm = ?", (key,))
    if own is not None:
        statement = (
            "INSERT INTO own_alarm (alarm, settings, who, changed_at, request)"
            " VALUES (?, ?, ?, ?, ?) RETURNING version"
        )
        written = own.settings.model_dump_json(exclude_defaults=True)
        row = (own.key, written, own.who, own.at, own.request)
        [(own.version,)] = connection.execute(statement, row)


def in_words(settings: AlarmSettings) -> str:
    """A definition in one line of the audit log, with the keys of ``[[alarm]]``."""
    return "; ".join(in_toml(settings).splitlines()[1:])

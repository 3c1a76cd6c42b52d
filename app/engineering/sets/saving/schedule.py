"""Sets saved daily at a chosen minute; a unit that does not respond then is read when it does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta

import structlog

from app.core.web.admission.access import Person, Role
from app.engineering.sets.acts import END_SCHEDULE, SCHEDULE
from app.engineering.sets.model import UnitRows
from app.engineering.sets.saving.keeper import SetKeeper
from app.engineering.sets.saving.taking import read_together
from app.errors import StoreError
from app.line.live.state.bus_live import BusLive
from app.people.audit.log import EventLog
from bus.instants import UnixTime
from bus.messages import Message

_log = structlog.get_logger(__name__)

SERVER = Person("server", Role.VIEWER, "worker")
"""Author of automatic actions: the daily sets, and reading what is compared with a golden set. It reads."""
LocalClock = Callable[[], datetime]
LOOK_EVERY_S = 5.0
REPORT_AFTER = timedelta(seconds=15)
"""A unit that has not responded for so long after it was due is reported."""


@dataclass(slots=True)
class OverdueSet:
    """A unit whose set of the day is not taken yet. ``since``: when that was noticed; ``why``: what was in
    the way at the last try, None before one."""

    since: datetime
    why: Message | None = None


class SetSchedule:
    """The daily sets of one bus. ``clock`` gives the local time with its zone."""

    def __init__(self, live: BusLive, keeper: SetKeeper, events: EventLog, clock: LocalClock) -> None:
        self._live = live
        self._bus = live.settings.name
        self._keeper = keeper
        self._events = events
        self._clock = clock
        self._overdue: dict[int, OverdueSet] = {}

    def overdue(self) -> Mapping[int, OverdueSet]:
        """The units whose set of the day could not be taken yet."""
        return {unit: overdue for unit, overdue in self._overdue.items() if overdue.why}

    async def set(self, person: Person, minute_of_day: int | None) -> None:
        """Take the sets every day at a minute of the day, or no longer (None)."""
        SCHEDULE.check(person)
        performed = END_SCHEDULE.by(person)
        if minute_of_day is not None:
            performed = SCHEDULE.by(person, time=f"{minute_of_day // 60:02}:{minute_of_day % 60:02}")
        await self._keeper.store.set_schedule(self._bus, minute_of_day)
        self._overdue = {}
        await self._events.record(**performed, bus=self._bus)

    async def follow(self, person: Person) -> None:
        """Run indefinitely; ``person`` is the author of the sets in the events. Sets due today while
        the server was not running are saved now."""
        seen = _midnight(self._clock()) - timedelta(seconds=1)
        while True:
            now = self._clock()
            await self.look(person, seen, now)
            seen = now
            await asyncio.sleep(LOOK_EVERY_S)

    async def look(self, person: Person, seen: datetime, now: datetime) -> None:
        """Save sets that came due after ``seen``, up to ``now``, and those overdue from before."""
        minute_of_day = (await self._keeper.store.schedule()).get(self._bus)
        due = None if minute_of_day is None else due_between(minute_of_day, seen, now)
        if due is not None:
            self._overdue = {unit: OverdueSet(now) for unit in await self._without_set(due)}
        overdue = self._overdue
        responding = [unit for unit in overdue if self._is_online(unit)]
        if responding:
            await self._take(person, responding, overdue)
        for unit, one in tuple(overdue.items()):
            if not one.why and not self._is_online(unit) and now - one.since >= REPORT_AFTER:
                await self._not_taken(person, unit, one, Message("unit_unread"))

    def _is_online(self, unit: int) -> bool:
        return self._live.units[unit].link.link == "online"

    async def _without_set(self, due: datetime) -> list[int]:
        since, store = UnixTime(due.timestamp()), self._keeper.store
        return [
            unit
            for unit in self._live.units
            if not await store.has_set_since(self._bus, unit, since, "on schedule")
        ]

    async def _take(self, person: Person, units: list[int], overdue: dict[int, OverdueSet]) -> None:
        read: list[UnitRows] = []
        missing: dict[int, Message] = {}
        await read_together(self._keeper, person, units, read, missing)
        try:
            if read:
                await self._keeper.keep(person, read, "", "", "on schedule")
            for rows in read:
                overdue.pop(rows.unit)
        except StoreError as error:
            _log.error("a set on schedule was not stored", bus=self._bus, error=str(error))
        for unit, why in missing.items():
            await self._not_taken(person, unit, overdue[unit], why)

    async def _not_taken(self, person: Person, unit: int, overdue: OverdueSet, why: Message) -> None:
        """Reported once; tried again as long as it is overdue."""
        first, overdue.why = not overdue.why, why
        if first:
            what, author = Message.of("event_set_not_taken", unit=unit), person.author
            await self._events.record(
                kind="parameter_set", **author, bus=self._bus, unit=unit, what=what, message=why
            )


def due_between(minute_of_day: int, since: datetime, until: datetime) -> datetime | None:
    """The last time at which this minute of the day began after ``since``, up to ``until``; None for none."""
    due = [_midnight(day) + timedelta(minutes=minute_of_day) for day in (until, since)]
    return next((at for at in due if since < at <= until), None)


def _midnight(of: datetime) -> datetime:
    return of.replace(hour=0, minute=0, second=0, microsecond=0)

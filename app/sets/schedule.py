"""Sets taken daily at a minute that a person chose; a unit that is silent then is read when it answers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta

import structlog

from app.audit.log import EventLog
from app.errors import StoreError
from app.live.state.live_state import LiveState
from app.sets.keeper import SetKeeper
from app.sets.model import UnitRows
from app.sets.taking import read_together
from app.web.access import Person
from bus.messages import Message

_log = structlog.get_logger(__name__)

LocalClock = Callable[[], datetime]
LOOK_EVERY_S = 5.0
SAID_AFTER = timedelta(seconds=15)
"""A unit that has not been heard for so long after it was due is said to be silent."""


@dataclass(slots=True)
class OverdueSet:
    """A unit whose set of the day is not taken yet. ``since``: when that was noticed; ``why``: what was in
    the way at the last try, empty before one."""

    since: datetime
    why: str = ""


class SetSchedule:
    """One for the app. ``clock`` gives the local time with its zone."""

    def __init__(self, state: LiveState, keeper: SetKeeper, events: EventLog, clock: LocalClock) -> None:
        self._state = state
        self._keeper = keeper
        self._events = events
        self._clock = clock
        self._overdue: dict[str, dict[int, OverdueSet]] = {}

    def overdue(self, bus: str) -> Mapping[int, OverdueSet]:
        """The units of a bus whose set of the day could not be taken yet."""
        return {unit: overdue for unit, overdue in self._overdue.get(bus, {}).items() if overdue.why}

    async def set(self, person: Person, bus: str, minute_of_day: int | None) -> None:
        """Take the sets of a bus every day at a minute of the day, or no longer (None)."""
        await self._keeper.store.set_schedule(bus, minute_of_day)
        self._overdue.pop(bus, None)
        what = Message("event_sets_not_scheduled")
        if minute_of_day is not None:
            time = f"{minute_of_day // 60:02}:{minute_of_day % 60:02}"
            what = Message.of("event_sets_scheduled", time=time)
        await self._record(person, bus, what)

    async def follow(self, person: Person) -> None:
        """Run for ever; ``person`` is whom the sets are taken for in the events. What came due today while
        the server was not running is made up for."""
        seen = _midnight(self._clock()) - timedelta(seconds=1)
        while True:
            now = self._clock()
            await self.look(person, seen, now)
            seen = now
            await asyncio.sleep(LOOK_EVERY_S)

    async def look(self, person: Person, seen: datetime, now: datetime) -> None:
        """Take what came due after ``seen``, up to ``now``, and what is owed from before."""
        for at, bus in due_between(await self._keeper.store.schedule(), seen, now):
            if bus in self._state.buses:
                self._overdue[bus] = {unit: OverdueSet(now) for unit in await self._without_set(bus, at)}
        for bus, units in tuple(self._overdue.items()):
            heard = [unit for unit in units if self._is_heard(bus, unit)]
            if heard:
                await self._take(person, bus, heard, units)
            for unit, overdue in tuple(units.items()):
                if not overdue.why and not self._is_heard(bus, unit) and now - overdue.since >= SAID_AFTER:
                    await self._not_taken(person, bus, unit, overdue, "the unit does not answer")

    def _is_heard(self, bus: str, unit: int) -> bool:
        return self._state.buses[bus].units[unit].link.link == "online"

    async def _without_set(self, bus: str, at: datetime) -> list[int]:
        store = self._keeper.store
        return [
            unit
            for unit in self._state.buses[bus].units
            if not await store.has_set_since(bus, unit, at.timestamp(), "on schedule")
        ]

    async def _take(self, person: Person, bus: str, units: list[int], overdue: dict[int, OverdueSet]) -> None:
        read, silent = await read_together(self._keeper, person, bus, units)
        if read and await self._keep(person, bus, read):
            for rows in read:
                overdue.pop(rows.unit)
        for unit, why in silent.items():
            await self._not_taken(person, bus, unit, overdue[unit], why)

    async def _keep(self, person: Person, bus: str, read: list[UnitRows]) -> bool:
        try:
            await self._keeper.keep(person, bus, read, "", "", "on schedule")
        except StoreError as error:
            _log.error("a set on schedule was not stored", bus=bus, error=str(error))
            return False
        return True

    async def _not_taken(self, person: Person, bus: str, unit: int, overdue: OverdueSet, why: str) -> None:
        """Said once; tried again as long as it is owed."""
        first, overdue.why = not overdue.why, why
        if first:
            what = Message.of("event_set_not_taken", unit=unit)
            await self._record(person, bus, what, unit, why)

    async def _record(
        self, person: Person, bus: str, what: Message, unit: int | None = None, message: str = ""
    ) -> None:
        await self._events.record(
            kind="parameter_set",
            who=person.name,
            origin=person.via,
            bus=bus,
            unit=unit,
            what=what,
            message=message,
        )


def due_between(schedule: Mapping[str, int], since: datetime, until: datetime) -> list[tuple[datetime, str]]:
    """When, and the buses whose minute of the day came after ``since``, up to ``until``, in order."""
    due: list[tuple[datetime, str]] = []
    for day in (since, until) if since.date() != until.date() else (until,):
        due += [(_midnight(day) + timedelta(minutes=minute), bus) for bus, minute in schedule.items()]
    return [(at, bus) for at, bus in sorted(due) if since < at <= until]


def _midnight(of: datetime) -> datetime:
    return of.replace(hour=0, minute=0, second=0, microsecond=0)

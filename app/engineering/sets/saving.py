"""The saving of parameter sets: by a person, daily, and before a unit's first write on a day."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, timedelta
from typing import Literal

import structlog

from app.core.lifespan import Background
from app.core.web.access import Person, Role
from app.core.web.arrival import Deadline
from app.engineering.sets.drift import BusDrift
from app.engineering.sets.model import (
    ParameterSet,
    SetOrigin,
    UnitRows,
    known_rows,
    rows_of,
    status_of,
)
from app.engineering.sets.store import SetStore
from app.errors import Problem, StoreError
from app.line.commands.service import CommandService, check_all_read
from app.line.live.bus_live import BusLive
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from app.people.auth.rights import Rights
from bus.catalogue.parameters import PARAMETERS
from bus.contract import ReadParameters
from bus.instants import UnixTime, unix_now
from bus.messages import Message, term

SAVE = Act("save_parameter_set", Role.ENGINEER, "parameter_set", "event_set_taken")
MARK_GOLDEN = Act("mark_golden_set", Role.ENGINEER, "parameter_set", "event_set_golden")
EXPORT_SECRET = Act("export_secret", Role.ENGINEER, "secret", "event_secret_exported")
SCHEDULE = Act("set_save_schedule", Role.ENGINEER, "parameter_set", "event_sets_scheduled")
END_SCHEDULE = Act("end_save_schedule", Role.ENGINEER, "parameter_set", "event_sets_not_scheduled")

SERVER = Person("server", Role.VIEWER, "worker")
"""The author of the server's own reads; it writes nothing."""
_READ_TIMEOUT_S = 300.0
"""The seconds for a full list in the gaps of the scan; at 300 baud one unit takes 30 s of wire."""
_CHECK_EVERY_S = 5.0
MAX_READINGS = 20
"""The readings of units whose progress is remembered."""
MAX_AT_ONCE = 4
"""The units that are read at once: taking turns saves the fence between two reads of one unit."""
REPORT_AFTER = timedelta(seconds=15)
"""The delay after which a unit that has not responded to its daily reading is reported."""
LocalClock = Callable[[], datetime]
"""A function that returns the local time with its zone."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class ParameterReader:
    """A reader of all parameters of units of one bus, through the command service."""

    _live: BusLive
    _commands: CommandService

    def motion(self, unit: int) -> tuple[bool | None, bool | None]:
        """Return the Run input and REMOTE of a unit as last read; None and None if it does not respond."""
        status = status_of(self._live, self._live.units[unit])
        return (None, None) if status is None else (status.run, status.remote)

    def values_since(self, unit: int, since: UnixTime) -> int:
        """Count the parameters of a unit that were read at or after ``since``."""
        return sum(value.at >= since for value in self._live.units[unit].parameters.values())

    async def read_unit(self, person: Person, unit: int, *, urgent: bool = False) -> UnitRows:
        """Read all 40 parameters of a unit.

        Raise Problem 503 if the bus is closed, 504 if the unit does not respond.
        """
        action = ReadParameters(unit=unit, numbers=list(PARAMETERS), urgent=urgent)
        result = await self._commands.send(person, action, deadline=Deadline.within(_READ_TIMEOUT_S))
        check_all_read(unit, action.numbers, result)
        return UnitRows(unit, self._live.units[unit].settings.name, rows_of(result.values))

    async def read_together(
        self, person: Person, units: Sequence[int], read: list[UnitRows], missing: dict[int, Message]
    ) -> None:
        """Read several units, a few at once. Meanwhile ``read`` gets those that responded, and ``missing``
        the reason why others did not."""
        at_once = asyncio.Semaphore(MAX_AT_ONCE)

        async def read_one(unit: int) -> None:
            async with at_once:
                try:
                    read.append(await self.read_unit(person, unit))
                except (Problem, StoreError) as error:
                    missing[unit] = error.message

        await asyncio.gather(*(read_one(unit) for unit in units))
        read.sort(key=lambda rows: units.index(rows.unit))


@dataclass(frozen=True, eq=False)
class SetKeeper:
    """The service that saves the sets of one bus and marks them golden."""

    _live: BusLive
    reader: ParameterReader
    _drift: BusDrift
    store: SetStore
    _events: EventLog
    _rights: Rights

    @property
    def bus(self) -> str:
        return self._live.settings.name

    async def read_and_save(
        self,
        person: Person,
        units: Sequence[int],
        name: str = "",
        comment: str = "",
        origin: SetOrigin = "by hand",
    ) -> ParameterSet:
        """Read the units now, one after another, and save their values.

        Raise Problem 504 or 503 if one does not respond; nothing is saved then.
        """
        SAVE.check(person)
        rows = [await self.reader.read_unit(person, unit) for unit in units]
        return await self.save(person, rows, origin, name, comment)

    async def save(
        self, person: Person, rows: Sequence[UnitRows], origin: SetOrigin, name: str = "", comment: str = ""
    ) -> ParameterSet:
        """Store the rows as a set, with an event. A person of any role may do so: the server does.

        Raise Problem 403 if the rights of the person were withdrawn during the reading, which takes a while.
        """
        await self._rights.check(person)
        kept = await self.store.save(
            ParameterSet(self.bus, unix_now(), person.name, origin, tuple(rows), name=name, comment=comment)
        )
        performed = SAVE.by(person, set=kept.id, units=[unit.unit for unit in rows], origin=term(origin))
        alone = rows[0].unit if len(rows) == 1 else None
        await self._events.record(**performed, bus=self.bus, unit=alone)
        return kept

    async def mark_golden(self, person: Person, stored: ParameterSet, units: Sequence[int]) -> None:
        """Make this set the golden set of the units. Raise Problem 404, and mark none, if the set lacks one
        of them."""
        MARK_GOLDEN.check(person)
        for unit in units:
            if stored.unit(unit) is None:
                raise Problem(404, "unknown_set", Message.of("set_lacks_unit", set=stored.id, unit=unit))
        await self.store.mark_golden(self.bus, units, stored.id, person.name, unix_now())
        for unit in units:
            performed = MARK_GOLDEN.by(person, set=stored.id, unit=unit)
            await self._events.record(**performed, bus=self.bus, unit=unit)
        await self._drift.load()

    async def read_marked(self) -> None:
        """Read completely, in the gaps of the scan, each unit whose golden set could not be compared yet,
        until canceled. The slow scan would take a quarter of an hour for that."""
        while True:
            await asyncio.sleep(_CHECK_EVERY_S)
            for unit in self._drift.marked():
                if self._live.units[unit].link.link != "online" or not self._drift.unread(unit):
                    continue
                try:
                    await self.reader.read_unit(SERVER, unit)
                except Problem as problem:
                    why = problem.detail
                    _log.info("a unit with a golden set was not read", bus=self.bus, unit=unit, why=why)


@dataclass(slots=True)
class SetReading:
    """A reading of units that began at ``began``, to be saved as one set; ``golden``: also as the golden set
    of each unit.

    ``missing``: the units that did not respond, with the reason; ``set_id``: the saved set; ``cause``: the
    reason why the values were not saved or not marked.
    """

    id: str
    bus: str
    units: tuple[int, ...]
    name: str
    comment: str
    golden: bool
    began: UnixTime
    state: Literal["reading", "kept", "failed"] = "reading"
    read: list[UnitRows] = field(default_factory=list)
    missing: dict[int, Message] = field(default_factory=dict)
    set_id: int | None = None
    cause: Message | None = None

    def values_read(self, keeper: SetKeeper) -> dict[int, int]:
        """Count the values read so far, by unit; all of them for a unit that was read."""
        ended = {rows.unit for rows in self.read}
        return {
            unit: len(PARAMETERS) if unit in ended else keeper.reader.values_since(unit, self.began)
            for unit in self.units
        }


class SetReadings:
    """The readings of units in the background for the page, and their results."""

    def __init__(self) -> None:
        self._readings: dict[str, SetReading] = {}
        self.background = Background()

    def get(self, reading_id: str) -> SetReading | None:
        """Return a reading that was begun since the server started."""
        return self._readings.get(reading_id)

    def begin(
        self,
        person: Person,
        keeper: SetKeeper,
        units: Sequence[int],
        name: str,
        comment: str,
        *,
        golden: bool = False,
    ) -> SetReading:
        """Read the units and save those that respond as one set; ``golden``: also mark it as the golden set
        of each unit."""
        SAVE.check(person)
        if golden:
            MARK_GOLDEN.check(person)
        reading = SetReading(
            secrets.token_hex(8), keeper.bus, tuple(units), name, comment, golden, unix_now()
        )
        self._readings[reading.id] = reading
        for old in list(self._readings)[:-MAX_READINGS]:
            del self._readings[old]
        self.background.begin(_read_and_save(person, keeper, reading), f"parameter set {reading.id}")
        return reading


async def _read_and_save(person: Person, keeper: SetKeeper, reading: SetReading) -> None:
    await keeper.reader.read_together(person, reading.units, reading.read, reading.missing)
    if not reading.read:
        reading.state = "failed"
        return
    try:
        kept = await keeper.save(person, reading.read, "by hand", reading.name, reading.comment)
        reading.set_id = kept.id
        if reading.golden:
            await keeper.mark_golden(person, kept, [rows.unit for rows in reading.read])
    except (Problem, StoreError) as error:
        reading.state, reading.cause = "failed", error.message
    else:
        reading.state = "kept"


class FirstWrites:
    """A hook that saves the known values of a unit before its first write on a day, without waiting for a
    reading."""

    def __init__(self, live: BusLive, commands: CommandService, keeper: SetKeeper, clock: LocalClock) -> None:
        self._live = live
        self._keeper = keeper
        self._clock = clock
        self._saved: dict[int, date] = {}
        """The last day on which a unit's set was saved."""
        self.background = Background()
        commands.on_write(self.before)

    async def before(self, person: Person, units: Sequence[int], parameters: bool) -> None:
        """Save units that are about to be written to.

        A write of ``parameters`` waits for that (milliseconds of disk; may raise StoreError). A setpoint or
        an output changes no parameter and waits for nothing; its unit is saved once all forty are known.
        """
        today, live = self._clock().date(), self._live.units
        needed = 1 if parameters else len(PARAMETERS)
        due = [unit for unit in units if self._saved.get(unit) != today]
        known = [known_rows(live[unit]) for unit in due if len(live[unit].parameters) >= needed]
        if known and parameters:
            await self._save(person, known)
        elif known:
            work = self._save_in_background(person, known)
            self.background.begin(work, f"first write of the day, {self._keeper.bus}")

    async def _save_in_background(self, person: Person, known: list[UnitRows]) -> None:
        try:
            await self._save(person, known)
        except (Problem, StoreError) as error:
            _log.error("the set before the first write of the day was not stored", error=str(error))

    async def _save(self, person: Person, known: list[UnitRows]) -> None:
        """Store a set of each unit that has none with today's date."""
        today, keeper = _midnight(self._clock()), self._keeper
        fresh: list[UnitRows] = []
        try:
            for rows in known:
                if self._saved.get(rows.unit) == today.date():
                    continue
                if not await keeper.store.has_set_since(keeper.bus, rows.unit, UnixTime(today.timestamp())):
                    fresh.append(rows)
                self._saved[rows.unit] = today.date()
            if fresh:
                await keeper.save(person, fresh, "before the first write of the day")
        except (Problem, StoreError):
            for rows in fresh:
                self._saved.pop(rows.unit, None)
            raise
        for rows in fresh:
            if len(rows.rows) < len(PARAMETERS):
                self.background.begin(self._complete(person, rows.unit), f"rest of unit {rows.unit}")

    async def _complete(self, person: Person, unit: int) -> None:
        """Read a unit completely, in the gaps of the scan, and save it again."""
        keeper = self._keeper
        try:
            rows = await keeper.reader.read_unit(person, unit)
            await keeper.save(person, [rows], "after the first write of the day")
        except (Problem, StoreError) as error:
            _log.info("the rest of a unit was not read", bus=keeper.bus, unit=unit, why=str(error))


@dataclass(slots=True)
class OverdueSet:
    """A daily set that a unit does not have yet. ``since``: the time when that was noticed; ``why``: the
    obstacle at the last attempt, None before the first."""

    since: datetime
    why: Message | None = None


class SetSchedule:
    """The schedule that saves the units of one bus daily; a unit that does not respond is read when it
    responds again."""

    def __init__(self, live: BusLive, keeper: SetKeeper, events: EventLog, clock: LocalClock) -> None:
        self._live = live
        self._bus = live.settings.name
        self._keeper = keeper
        self._events = events
        self._clock = clock
        self._overdue: dict[int, OverdueSet] = {}

    def overdue(self) -> Mapping[int, OverdueSet]:
        """Return the units whose daily set could not be saved yet."""
        return {unit: overdue for unit, overdue in self._overdue.items() if overdue.why}

    async def set(self, person: Person, minute_of_day: int | None) -> None:
        """Save the units daily at a minute of the local day; None ends the schedule."""
        SCHEDULE.check(person)
        performed = END_SCHEDULE.by(person)
        if minute_of_day is not None:
            performed = SCHEDULE.by(person, time=f"{minute_of_day // 60:02}:{minute_of_day % 60:02}")
        await self._keeper.store.set_schedule(self._bus, minute_of_day)
        self._overdue = {}
        await self._events.record(**performed, bus=self._bus)

    async def follow(self) -> None:
        """Save sets when they are due, until canceled. Sets that came due today while the server was not
        running are saved now."""
        seen = _midnight(self._clock()) - timedelta(seconds=1)
        while True:
            now = self._clock()
            await self.save_due(seen, now)
            seen = now
            await asyncio.sleep(_CHECK_EVERY_S)

    async def save_due(self, seen: datetime, now: datetime) -> None:
        """Save the sets that came due after ``seen`` and up to ``now``, and those that are overdue."""
        minute_of_day = (await self._keeper.store.schedule()).get(self._bus)
        due = None if minute_of_day is None else due_between(minute_of_day, seen, now)
        if due is not None:
            self._overdue = {unit: OverdueSet(now) for unit in await self._without_set(due)}
        overdue = self._overdue
        responding = [unit for unit in overdue if self._is_online(unit)]
        if responding:
            await self._save(responding, overdue)
        for unit, one in tuple(overdue.items()):
            if not one.why and not self._is_online(unit) and now - one.since >= REPORT_AFTER:
                await self._report(unit, one, Message("unit_unread"))

    def _is_online(self, unit: int) -> bool:
        return self._live.units[unit].link.link == "online"

    async def _without_set(self, due: datetime) -> list[int]:
        since, store = UnixTime(due.timestamp()), self._keeper.store
        return [
            unit
            for unit in self._live.units
            if not await store.has_set_since(self._bus, unit, since, "on schedule")
        ]

    async def _save(self, units: list[int], overdue: dict[int, OverdueSet]) -> None:
        read: list[UnitRows] = []
        missing: dict[int, Message] = {}
        await self._keeper.reader.read_together(SERVER, units, read, missing)
        try:
            if read:
                await self._keeper.save(SERVER, read, "on schedule")
            for rows in read:
                overdue.pop(rows.unit)
        except StoreError as error:
            _log.error("a set on schedule was not stored", bus=self._bus, error=str(error))
        for unit, why in missing.items():
            await self._report(unit, overdue[unit], why)

    async def _report(self, unit: int, overdue: OverdueSet, why: Message) -> None:
        """Record, the first time only, why a unit has no daily set."""
        first, overdue.why = not overdue.why, why
        if first:
            what, author = Message.of("event_set_not_taken", unit=unit), SERVER.author
            await self._events.record(
                kind=SAVE.kind, **author, bus=self._bus, unit=unit, what=what, message=why
            )


def due_between(minute_of_day: int, since: datetime, until: datetime) -> datetime | None:
    """Return the last time after ``since``, up to ``until``, at which this minute of the day began."""
    due = [_midnight(day) + timedelta(minutes=minute_of_day) for day in (until, since)]
    return next((at for at in due if since < at <= until), None)


def _midnight(at: datetime) -> datetime:
    return at.replace(hour=0, minute=0, second=0, microsecond=0)

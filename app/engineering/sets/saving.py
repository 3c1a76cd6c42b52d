"""Reading complete parameter lists from units, through the command service.

Saving sets and marking them golden; units with a golden set are read completely soon after a start.

Reading many units for one set: takes the gaps of the scan, so it goes on in the background.

Saves a unit's values before the first write to it on a day. No write waits for the wire because of it: the
values are those read by then.

Sets saved daily at a chosen minute; a unit that does not respond then is read when it does.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, timedelta
from typing import Literal

import structlog

from app.core.lifespan import Background
from app.core.web.admission.access import Person, Role
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
from app.line.commands.service.command_service import CommandService
from app.line.commands.service.prior_read import check_all_read
from app.line.live.bus_live import BusLive
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from app.people.auth.rights.rights import Rights
from bus.catalogue.parameters import PARAMETERS
from bus.contract import ReadParameters
from bus.instants import UnixTime, unix_now
from bus.messages import Message, term

SAVE = Act("save_parameter_set", Role.ENGINEER, "parameter_set", "event_set_taken")
MARK_GOLDEN = Act("mark_golden_set", Role.ENGINEER, "parameter_set", "event_set_golden")
EXPORT_SECRET = Act("export_secret", Role.ENGINEER, "secret", "event_secret_exported")
SCHEDULE = Act("set_save_schedule", Role.ENGINEER, "parameter_set", "event_sets_scheduled")
END_SCHEDULE = Act("end_save_schedule", Role.ENGINEER, "parameter_set", "event_sets_not_scheduled")

_log = structlog.get_logger(__name__)

READ_TIMEOUT_S = 300.0
"""A full list waits for gaps in the scan; at 300 baud one unit takes half a minute of wire alone."""


@dataclass(frozen=True, slots=True, eq=False)
class ParameterReader:
    """Reads units of one bus now; an unread or partly read unit is reported as such."""

    _live: BusLive
    _commands: CommandService

    def motion(self, unit: int) -> tuple[bool | None, bool | None]:
        """The Run input and REMOTE of a unit as last read; None for one that does not respond."""
        status = status_of(self._live, self._live.units[unit])
        return (None, None) if status is None else (status.run, status.remote)

    def values_since(self, unit: int, since: UnixTime) -> int:
        """How many parameters of a unit were read at or after ``since``."""
        return sum(value.at >= since for value in self._live.units[unit].parameters.values())

    async def read_unit(self, person: Person, unit: int, *, urgent: bool = False) -> UnitRows:
        """All 40 parameters as the unit reports them now.

        Raises Problem 503 when the bus is closed, 504 when the unit does not respond.
        """
        action = ReadParameters(unit=unit, numbers=list(PARAMETERS), urgent=urgent)
        result = await self._commands.send(person, action, timeout_s=READ_TIMEOUT_S)
        check_all_read(unit, action.numbers, result)
        return UnitRows(unit, self._live.units[unit].settings.name, rows_of(result.values))


_LEARN_EVERY_S = 5.0


@dataclass(frozen=True, eq=False)
class SetKeeper:
    """Takes and keeps the sets of one bus."""

    _live: BusLive
    reader: ParameterReader
    _drift: BusDrift
    store: SetStore
    _events: EventLog
    _rights: Rights

    @property
    def bus(self) -> str:
        return self._live.settings.name

    async def take(
        self,
        person: Person,
        units: Sequence[int],
        name: str = "",
        comment: str = "",
        origin: SetOrigin = "by hand",
    ) -> ParameterSet:
        """Read the units now, one after another, and save their values.

        Raises Problem 504 or 503 when one does not respond; nothing is saved then.
        """
        SAVE.check(person)
        rows = [await self.reader.read_unit(person, unit) for unit in units]
        return await self.keep(person, rows, name, comment, origin)

    async def mark_golden(self, person: Person, stored: ParameterSet, units: Sequence[int]) -> None:
        """Make this set the golden set of the units. Raises Problem 404 where it does not hold one of them;
        none is marked then."""
        MARK_GOLDEN.check(person)
        for unit in units:
            if stored.unit(unit) is None:
                raise Problem(404, "unknown_set", Message.of("set_lacks_unit", set=stored.id, unit=unit))
        await self.store.mark_golden(self.bus, units, stored.id, person.name, unix_now())
        for unit in units:
            performed = MARK_GOLDEN.by(person, set=stored.id, unit=unit)
            await self._events.record(**performed, bus=self.bus, unit=unit)
        await self._drift.load()

    async def learn_marked(self, person: Person) -> None:
        """Run indefinitely: read completely, in the gaps of the scan, the units whose golden set could not be
        compared yet. The slow scan would take a quarter of an hour for it."""
        while True:
            await asyncio.sleep(_LEARN_EVERY_S)
            for unit in self._drift.marked():
                if self._live.units[unit].link.link != "online" or not self._drift.unread(unit):
                    continue
                try:
                    await self.reader.read_unit(person, unit)
                except Problem as problem:
                    why = problem.detail
                    _log.info("a unit with a golden set was not read", bus=self.bus, unit=unit, why=why)

    async def keep(
        self, person: Person, rows: Sequence[UnitRows], name: str, comment: str, origin: SetOrigin
    ) -> ParameterSet:
        """Store what was read as a set, with an event; of any role, as the server keeps sets too.

        Reading takes a while: raises Problem 403 when the rights of the person were withdrawn meanwhile.
        """
        await self._rights.check(person)
        kept = await self.store.save(
            ParameterSet(self.bus, unix_now(), person.name, origin, tuple(rows), name=name, comment=comment)
        )
        performed = SAVE.by(person, set=kept.id, units=[unit.unit for unit in rows], origin=term(origin))
        alone = rows[0].unit if len(rows) == 1 else None
        await self._events.record(**performed, bus=self.bus, unit=alone)
        return kept


MAX_TAKINGS = 20
"""Readings whose progress is kept."""
MAX_AT_ONCE = 4
"""Reads of several units take turns on the wire, which saves the fence between two reads of one."""


@dataclass(slots=True)
class Taking:
    """A set being read since ``began``, to be the ``golden`` set of its units or not. ``set_id`` once it is
    saved; ``missing``: the units that did not respond, with the reason; ``cause``: why it was not saved, or
    not marked, although units responded."""

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
        """How many values of each unit have been read so far; all of a unit that will not be read further."""
        ended = self.missing.keys() | {rows.unit for rows in self.read}
        return {
            unit: len(PARAMETERS) if unit in ended else keeper.reader.values_since(unit, self.began)
            for unit in self.units
        }


class Takings:
    """Begins readings and remembers how they went."""

    def __init__(self) -> None:
        self._takings: dict[str, Taking] = {}
        self.background = Background()

    def get(self, taking_id: str) -> Taking | None:
        """A reading begun since the server started."""
        return self._takings.get(taking_id)

    def begin(
        self,
        person: Person,
        keeper: SetKeeper,
        units: Sequence[int],
        name: str,
        comment: str,
        *,
        golden: bool = False,
    ) -> Taking:
        """Read the units one after another and save their values as one set; ``golden``: and mark it as the
        golden set of each unit that was read."""
        SAVE.check(person)
        if golden:
            MARK_GOLDEN.check(person)
        taking = Taking(secrets.token_hex(8), keeper.bus, tuple(units), name, comment, golden, unix_now())
        self._takings[taking.id] = taking
        for old in list(self._takings)[:-MAX_TAKINGS]:
            del self._takings[old]
        self.background.begin(self._run(person, keeper, taking), f"parameter set {taking.id}")
        return taking

    async def _run(self, person: Person, keeper: SetKeeper, taking: Taking) -> None:
        await read_together(keeper, person, taking.units, taking.read, taking.missing)
        if not taking.read:
            taking.state = "failed"
            return
        try:
            kept = await keeper.keep(person, taking.read, taking.name, taking.comment, "by hand")
            taking.set_id = kept.id
            if taking.golden:
                await keeper.mark_golden(person, kept, [rows.unit for rows in taking.read])
        except (Problem, StoreError) as error:
            taking.state, taking.cause = "failed", error.message
            return
        taking.state = "kept"


async def read_together(
    keeper: SetKeeper,
    person: Person,
    units: Sequence[int],
    read: list[UnitRows],
    missing: dict[int, Message],
) -> None:
    """Read units completely, a few at once: on the way ``read`` gets those that responded, and ``missing``
    why the others did not."""
    at_once = asyncio.Semaphore(MAX_AT_ONCE)

    async def read_one(unit: int) -> None:
        async with at_once:
            try:
                read.append(await keeper.reader.read_unit(person, unit))
            except (Problem, StoreError) as error:
                missing[unit] = error.message

    await asyncio.gather(*(read_one(unit) for unit in units))
    read.sort(key=lambda rows: units.index(rows.unit))


class FirstWrites:
    """Stores a set before the first write of a day to a unit of one bus. ``clock`` returns the local time
    with its zone: a day begins at its midnight."""

    def __init__(
        self, live: BusLive, commands: CommandService, keeper: SetKeeper, clock: Callable[[], datetime]
    ) -> None:
        self._live = live
        self._bus = live.settings.name
        self._keeper = keeper
        self._clock = clock
        self._kept: dict[int, date] = {}
        self.background = Background()
        commands.on_write(self.before)

    async def before(self, person: Person, units: Sequence[int], *, parameters: bool) -> None:
        """``units`` are about to be written to. A write of ``parameters`` waits until they are stored (a few
        milliseconds of disk; raises StoreError); a setpoint or an output changes no parameter and waits for
        nothing, and is kept only when all forty are known."""
        today, live = self._clock().date(), self._live.units
        needed = 1 if parameters else len(PARAMETERS)
        due = [unit for unit in units if self._kept.get(unit) != today]
        known = [known_rows(live[unit]) for unit in due if len(live[unit].parameters) >= needed]
        if known and parameters:
            await self._keep(person, known)
        elif known:
            self.background.begin(self._keep_behind(person, known), f"first write of the day, {self._bus}")

    async def _keep_behind(self, person: Person, known: list[UnitRows]) -> None:
        try:
            await self._keep(person, known)
        except (Problem, StoreError) as error:
            _log.error("the set before the first write of the day was not stored", error=str(error))

    async def _keep(self, person: Person, known: list[UnitRows]) -> None:
        """Store the units that have no set of today yet."""
        now, fresh = self._clock(), list[UnitRows]()
        midnight = UnixTime(now.replace(hour=0, minute=0, second=0, microsecond=0).timestamp())
        try:
            for rows in known:
                if self._kept.get(rows.unit) == now.date():
                    continue
                if not await self._keeper.store.has_set_since(self._bus, rows.unit, midnight):
                    fresh.append(rows)
                self._kept[rows.unit] = now.date()
            if fresh:
                await self._keeper.keep(person, fresh, "", "", "before the first write of the day")
        except (Problem, StoreError):
            for rows in fresh:
                self._kept.pop(rows.unit, None)
            raise
        for rows in fresh:
            if len(rows.rows) < len(PARAMETERS):
                self.background.begin(self._complete(person, rows.unit), f"rest of unit {rows.unit}")

    async def _complete(self, person: Person, unit: int) -> None:
        """Values that were not known before the write follow in a separate set, in the gaps of the scan."""
        try:
            rows = await self._keeper.reader.read_unit(person, unit)
            await self._keeper.keep(person, [rows], "", "", "after the first write of the day")
        except (Problem, StoreError) as error:
            _log.info("the rest of a unit was not read", bus=self._bus, unit=unit, why=str(error))


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

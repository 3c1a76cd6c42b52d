"""Taking sets: by hand, daily on schedule, and before the first write of a day; and what drifts."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta

import structlog

from app.audit.log import EventLog
from app.errors import Problem
from app.live.state import LiveState
from app.sets.compare import Compared, drift
from app.sets.model import Origin, ParameterSet, UnitRows
from app.sets.reading import ParameterReader, known_rows
from app.sets.store import SetStore
from app.web.access import Person
from bus.contract import ParameterValue, Update

_log = structlog.get_logger(__name__)

Clock = Callable[[], datetime]
_LOOK_EVERY_S = 20.0


class SetKeeper:
    """One for the app. ``clock`` gives the local time with its zone."""

    def __init__(
        self, state: LiveState, reader: ParameterReader, store: SetStore, events: EventLog, clock: Clock
    ) -> None:
        self._state = state
        self._reader = reader
        self.store = store
        self._events = events
        self._clock = clock
        self._golden: dict[tuple[str, int], UnitRows] = {}
        self._drifted: dict[tuple[str, int], int] = {}
        state.subscribe(self._see)

    async def load(self) -> None:
        """Read which sets are golden; once at start, and after a mark has moved."""
        self._golden = await self.store.golden()
        self._drifted = {key: len(self.drift(*key)) for key in self._golden if key[0] in self._state.buses}

    def golden(self, bus: str, unit: int) -> UnitRows | None:
        """What a unit ought to be, where somebody has said so."""
        return self._golden.get((bus, unit))

    def drift(self, bus: str, unit: int) -> list[Compared]:
        """Rows in which a unit, as last read, departs from its golden set."""
        golden = self.golden(bus, unit)
        live = self._state.buses[bus].units.get(unit)
        return drift(golden, known_rows(live)) if golden is not None and live is not None else []

    def drifted(self, bus: str, unit: int) -> int:
        """In how many rows a unit departs from its golden set; 0 where it has none."""
        return self._drifted.get((bus, unit), 0)

    async def take(
        self,
        person: Person,
        bus: str,
        units: Sequence[int],
        name: str,
        comment: str,
        origin: Origin = "by hand",
    ) -> ParameterSet:
        """Read the units now, one after another, and keep what they say.

        Raises Problem 504 or 503 when one does not answer; nothing is kept then.
        """
        rows = [await self.read(person, bus, unit) for unit in units]
        return await self.keep(person, bus, rows, name, comment, origin)

    async def read(self, person: Person, bus: str, unit: int) -> UnitRows:
        """All parameters of a unit, read in the gaps of the scan. Raises Problem 504 or 503."""
        return await self._reader.read_unit(person, bus, unit)

    async def keep_known(self, person: Person, bus: str, unit: int) -> None:
        """Before the first write to a unit on a day: keep what it was, as it was last read."""
        live = self._state.buses[bus].units[unit]
        midnight = self._clock().replace(hour=0, minute=0, second=0, microsecond=0).timestamp()
        if not live.parameters or await self.store.has_set_since(bus, unit, midnight):
            return
        await self.keep(person, bus, [known_rows(live)], "", "", "before the first write of the day")

    async def mark_golden(self, person: Person, set_id: int, unit: int) -> None:
        """From now on the unit ought to be as this set says. Raises Problem 404 where it does not hold it."""
        stored = await self.store.load(set_id)
        if stored is None or stored.unit(unit) is None:
            raise Problem(404, "unknown_set", f"set {set_id} does not hold unit {unit}")
        await self.store.mark_golden(stored.bus, unit, set_id, person.name, time.time())
        await self.load()
        await self._events.record(
            kind="parameter_set",
            who=person.name,
            bus=stored.bus,
            unit=unit,
            what=f"set {set_id} is the golden set of unit {unit} now",
        )

    async def set_schedule(self, person: Person, bus: str, minute_of_day: int | None) -> None:
        """Take the sets of a bus every day at a minute of the day, or no longer (None)."""
        await self.store.set_schedule(bus, minute_of_day)
        when = (
            "not by schedule"
            if minute_of_day is None
            else f"daily at {minute_of_day // 60:02}:{minute_of_day % 60:02}"
        )
        await self._events.record(
            kind="parameter_set", who=person.name, bus=bus, unit=None, what=f"parameter sets are taken {when}"
        )

    async def follow_schedule(self, person: Person) -> None:
        """Run for ever; ``person`` is whom the sets are taken for in the events."""
        seen = self._clock()
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            now = self._clock()
            for bus in due_between(await self.store.schedule(), seen, now):
                await self._take_scheduled(person, bus)
            seen = now

    async def _take_scheduled(self, person: Person, bus: str) -> None:
        for unit in self._state.buses[bus].units if bus in self._state.buses else ():
            try:
                await self.take(person, bus, [unit], "", "", "on schedule")
            except Problem as problem:
                _log.warning(
                    "a scheduled parameter set was not taken", bus=bus, unit=unit, why=problem.detail
                )

    def _see(self, bus: str, updates: Sequence[Update]) -> None:
        """A parameter was read: count anew, so that nobody has to compare forty rows at every reading."""
        for unit in {update.unit for update in updates if isinstance(update, ParameterValue)}:
            if (bus, unit) in self._golden:
                self._drifted[bus, unit] = len(self.drift(bus, unit))

    async def keep(
        self, person: Person, bus: str, rows: Sequence[UnitRows], name: str, comment: str, origin: Origin
    ) -> ParameterSet:
        """Store what was read as a set, with an event."""
        kept = await self.store.save(
            ParameterSet(bus, time.time(), person.name, origin, tuple(rows), name=name, comment=comment)
        )
        numbers = ", ".join(str(unit.unit) for unit in rows)
        await self._events.record(
            kind="parameter_set",
            who=person.name,
            bus=bus,
            unit=rows[0].unit if len(rows) == 1 else None,
            what=f"parameter set {kept.id} taken of unit {numbers}, {origin}",
        )
        return kept


def due_between(schedule: dict[str, int], since: datetime, until: datetime) -> list[str]:
    """The buses whose minute of the day came after ``since``, up to ``until``, in order."""
    due: list[tuple[datetime, str]] = []
    for day in (since, until) if since.date() != until.date() else (until,):
        midnight = day.replace(hour=0, minute=0, second=0, microsecond=0)
        due += [(midnight + timedelta(minutes=minute), bus) for bus, minute in schedule.items()]
    return [bus for at, bus in sorted(due) if since < at <= until]

"""Saving sets and marking them golden; units with a golden set are read completely soon after a start."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

import structlog

from app.core.web.admission.access import Person
from app.engineering.sets.acts import MARK_GOLDEN, SAVE
from app.engineering.sets.comparison.drift import BusDrift
from app.engineering.sets.model import ParameterSet, SetOrigin, UnitRows
from app.engineering.sets.saving.reading import ParameterReader
from app.engineering.sets.store import SetStore
from app.errors import Problem
from app.line.live.state.bus_live import BusLive
from app.people.audit.log import EventLog
from app.people.auth.rights.rights import Rights
from bus.instants import unix_now
from bus.messages import Message, term

_log = structlog.get_logger(__name__)

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

"""Saves a unit's values before the first write to it on a day. No write waits for the wire because of it: the
values are those read by then."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import date, datetime

import structlog

from app.core.web.admission.access import Person
from app.engineering.sets.model import UnitRows
from app.engineering.sets.saving.background import Background
from app.engineering.sets.saving.keeper import SetKeeper
from app.engineering.sets.saving.reading import known_rows
from app.errors import Problem, StoreError
from app.line.commands.service.command_service import CommandService
from app.line.live.state.bus_live import BusLive
from bus.catalogue.parameters import PARAMETERS
from bus.instants import UnixTime

_log = structlog.get_logger(__name__)


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

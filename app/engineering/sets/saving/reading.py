"""Reading complete parameter lists from units, through the command service."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from app.core.web.admission.access import Person
from app.engineering.sets.model import ParameterRow, UnitRows
from app.line.commands.service.command_service import CommandService
from app.line.commands.service.prior_read import check_all_read
from app.line.live.state.bus_live import BusLive, UnitLive
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import StatusBits, status_bits
from bus.contract import ParameterValue, ReadParameters
from bus.instants import UnixTime

READ_TIMEOUT_S = 300.0
"""A full list waits for gaps in the scan; at 300 baud one unit takes half a minute of wire alone."""


def rows_of(values: Iterable[ParameterValue]) -> dict[int, ParameterRow]:
    """Values of responses, by parameter number."""
    return {
        value.number: ParameterRow(value.number, value.raw, value.available, value.at, value.frame)
        for value in values
    }


def known_rows(unit: UnitLive) -> UnitRows:
    """The known values of a live unit without a request, each row with the time it was read."""
    return UnitRows(unit.settings.id, unit.settings.name, rows_of(unit.parameters.values()))


def status_of(bus: BusLive, unit: UnitLive) -> StatusBits | None:
    """The inputs and the mode of a unit as last read; None for one that does not respond."""
    if unit.reading is None or unit.link.link in ("unknown", "offline"):
        return None
    return status_bits(unit.reading.outputs, unit.reading.inputs, bus.settings.estop_healthy)


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

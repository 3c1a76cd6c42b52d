"""What a person typed → the integer on the wire, by the decimals (#3) and mode (#8) of the unit.

Where those are not known yet, or may have changed, they are read first, within the time of the command.
"""

from __future__ import annotations

from app.core.web.access import Person
from app.core.web.arrival import Deadline
from app.errors import Problem
from app.line.commands.review import present_setpoint
from app.line.commands.service.command_service import CommandService
from app.line.commands.values import raw_of_percent
from app.line.live.bus_live import BusLive, UnitLive
from bus.catalogue.numbers import DECIMALS, FOLLOWER_MODE, RATIO_SETPOINT
from bus.catalogue.parameter import Scale
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.values import is_follower, parameter_raw, ratio_raw, speed_raw
from bus.messages import Message

_NEEDS = {Scale.SPEED: (DECIMALS,), Scale.SPEED_OR_RATIO: (DECIMALS, FOLLOWER_MODE)}


class ValueConverter:
    """Converts for one unit within the time of the command. Raises CallerError for text that is no number."""

    def __init__(
        self, commands: CommandService, person: Person, bus: BusLive, unit: UnitLive, deadline: Deadline
    ) -> None:
        self._commands = commands
        self._bus = bus
        self._person = person
        self._unit = unit
        self._deadline = deadline

    async def setpoint(self, text: str) -> int:
        """A speed in display units, or a follower's ratio; either in percent of the unit's own setpoint."""
        known = await self._known((DECIMALS, FOLLOWER_MODE))
        if text.rstrip().endswith("%"):
            is_known = self._unit.link.link == "online"
            return raw_of_percent(text, present_setpoint(self._bus, self._unit) if is_known else None)
        if is_follower(known[FOLLOWER_MODE]):
            return ratio_raw(text)
        decimals = known[DECIMALS]
        if decimals is None:
            unit = self._unit.settings.id
            raise Problem(422, "invalid", Message.of("unit_without_decimals", unit=unit), unit=unit)
        return speed_raw(text, decimals)

    async def parameter(self, number: int, text: str) -> int:
        """The value of one of the 40."""
        parameter = PARAMETERS[number]
        known = await self._known(_NEEDS.get(parameter.scale, ()))
        follower = is_follower(known.get(FOLLOWER_MODE)) or number == RATIO_SETPOINT
        return parameter_raw(parameter, text, known.get(DECIMALS), follower=follower)

    async def _known(self, numbers: tuple[int, ...]) -> dict[int, int | None]:
        missing = [number for number in numbers if not self._unit.is_current(number)]
        known = {number: self._unit.parameter_raw(number) for number in numbers}
        if missing:
            unit = self._unit.settings.id
            known |= await self._commands.read(self._person, unit, missing, self._deadline)
        return known

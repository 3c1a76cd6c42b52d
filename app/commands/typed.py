"""What a person typed → the integer on the wire, by the decimals (#3) and mode (#8) of the unit.

Where those are not known yet they are read first, within the time of the command.
"""

from __future__ import annotations

from app.commands.bodies import Quantity
from app.commands.desk import Desk
from app.commands.rules import COMMAND_RATIO
from app.errors import Problem
from app.live.state import MODE, UnitLive
from app.live.view import DECIMALS
from app.web.access import Person
from app.web.deadline import Deadline
from bus.catalogue.parameter import Scale
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.values import parameter_raw, ratio_raw, speed_raw
from bus.contract import ReadParameters

_NEEDS = {Scale.SPEED: (DECIMALS,), Scale.SPEED_OR_RATIO: (DECIMALS, MODE)}


class Typed:
    """Converts for one unit within the time of the command. Raises CallerError for what is no number."""

    def __init__(self, desk: Desk, person: Person, bus: str, unit: UnitLive, deadline: Deadline) -> None:
        self._desk = desk
        self._person = person
        self._bus = bus
        self._unit = unit
        self._deadline = deadline

    async def setpoint(self, quantity: Quantity) -> int:
        """A speed in display units, or a follower's ratio."""
        if quantity.raw is not None:
            return quantity.raw
        known = await self._known((DECIMALS, MODE))
        if known[MODE] in (1, 2):
            return ratio_raw(quantity.typed)
        return speed_raw(quantity.typed, self._decimals(known))

    async def parameter(self, number: int, quantity: Quantity) -> int:
        """The value of one of the 40."""
        if quantity.raw is not None:
            return quantity.raw
        parameter = PARAMETERS[number]
        known = await self._known(_NEEDS.get(parameter.scale, ()))
        follower = known.get(MODE) in (1, 2) or number == COMMAND_RATIO
        return parameter_raw(parameter, quantity.typed, known.get(DECIMALS), follower=follower)

    async def _known(self, numbers: tuple[int, ...]) -> dict[int, int | None]:
        missing = [number for number in numbers if number not in self._unit.parameters]
        known = {number: self._unit.parameter_raw(number) for number in numbers}
        if missing:
            known |= await self._read(missing)
        return known

    async def _read(self, numbers: list[int]) -> dict[int, int | None]:
        action = ReadParameters(unit=self._unit.settings.id, numbers=numbers)
        result = await self._desk.ask(self._person, self._bus, action, deadline=self._deadline)
        values: dict[int, int | None] = {value.number: value.raw for value in result.values}
        if result.outcome == "bus_closed":
            raise Problem(503, "bus_closed", result.message, outcome="bus_closed")
        if not values.keys() >= set(numbers):
            raise self._unreadable(result.message)
        return values

    def _decimals(self, known: dict[int, int | None]) -> int:
        decimals = known[DECIMALS]
        if decimals is None:
            raise self._unreadable("the unit says it has none")
        return decimals

    def _unreadable(self, cause: str) -> Problem:
        unit = self._unit.settings.id
        detail = (
            f"unit {unit}: its decimals (#3) and mode (#8) could not be read, so nothing was sent: {cause}"
        )
        return Problem(504, "unverified", detail, outcome="unverified", unit=unit)

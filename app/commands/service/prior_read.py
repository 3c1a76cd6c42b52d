"""Reads what must be known of a unit before a command can be judged, within the command's time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Protocol

from app.commands.catalogue import kind_of_command
from app.commands.rules.setpoint_range import unread_for_range
from app.commands.safeguards.limits import Limits
from app.errors import Problem
from app.live.state.bus_live import BusLive
from app.web.access import Person
from app.web.arrival import Deadline
from bus.contract import Action, Outcome, ReadParameters, Result, UnitOutcome
from bus.instants import UnixTime
from bus.messages import Message

_PASSES = 2
"""Which parameters bound a setpoint depends on the mode (#8), which may have to be read itself."""


class UnreadError(Problem):
    """What a command needs to know of a unit cannot be read: 503 ``bus_closed`` or 504 ``unverified``."""

    def result(self, id: str, at: UnixTime, units: Sequence[int]) -> Result:
        """The same as what became of a command for ``units`` of which nothing was sent."""
        outcome: Outcome = "bus_closed" if self.code == "bus_closed" else "unverified"
        parts = [UnitOutcome(unit, "not_sent", Message("unit_untouched")) for unit in units]
        return Result(id, at, outcome, self.message, units=parts)


class CommandSender(Protocol):
    """Sends a read command."""

    async def __call__(self, person: Person, action: Action, *, deadline: Deadline) -> Result: ...


async def read_first(
    send: CommandSender, person: Person, unit: int, numbers: Sequence[int], deadline: Deadline
) -> dict[int, int | None]:
    """The raw value of each, None where the unit does not have it.

    Raises UnreadError where it cannot be had, and Problem 503 ``not_sent`` where the time is over.
    """
    action = ReadParameters(unit=unit, numbers=list(numbers))
    result = await send(person, action, deadline=deadline)
    values: dict[int, int | None] = {value.number: value.raw for value in result.values}
    if result.outcome == "bus_closed":
        raise UnreadError(
            503, "bus_closed", result.message or Message("bus_not_linked"), outcome="bus_closed"
        )
    if not values.keys() >= set(numbers):
        raise _unread(unit, numbers)
    return values


async def read_ranges(
    send: CommandSender,
    person: Person,
    live: BusLive,
    action: Action,
    limits: Callable[[int], Limits],
    deadline: Deadline,
) -> None:
    """Make known what bounds the setpoints of ``action``. Raises as :func:`read_first`."""
    for _ in range(_PASSES):
        unread = _unread_by_unit(live, action, limits)
        if not unread:
            return
        reads = (read_first(send, person, unit, unread[unit], deadline) for unit in unread)
        await asyncio.gather(*reads)
    for unit, numbers in _unread_by_unit(live, action, limits).items():
        raise _unread(unit, numbers)


def _unread_by_unit(
    live: BusLive, action: Action, limits: Callable[[int], Limits]
) -> dict[int, tuple[int, ...]]:
    unread = {
        new.unit: unread_for_range(live.units[new.unit], limits(new.unit), new.raw, new.kind)
        for new in kind_of_command(action).setpoints(action, live)
    }
    return {unit: numbers for unit, numbers in unread.items() if numbers}


def _unread(unit: int, numbers: Sequence[int]) -> UnreadError:
    return UnreadError(
        504,
        "unverified",
        Message.of("unit_gave_too_little", unit=unit, numbers=[f"#{number}" for number in numbers]),
        outcome="unverified",
        unit=unit,
    )

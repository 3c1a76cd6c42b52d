"""What every review needs before it can be shown: that its command would be sent, and what it will do."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from contextlib import suppress

from app.commands.forms.page_context import PageContext
from app.commands.review.ramp import ramp_parameters_missing
from app.commands.review.risks import RiskInputs, SetpointChange, change_of, facts_of, obstacle_of
from app.commands.service.prior_read import read_first
from app.errors import Problem
from app.web.access import Person
from app.web.arrival import Deadline
from bus.contract import Action
from bus.instants import unix_now
from bus.messages import Message


async def judge(
    page: PageContext, person: Person, bus: str, action: Action, deadline: Deadline | None = None
) -> None:
    """All checks of a command; what they need to know of the units is read first, within its time.

    Raises Problem for what would not be sent.
    """
    deadline = deadline or page.deadline(page.bus(bus))
    await page.commands(bus).read_ranges(person, action, deadline)
    page.commands(bus).check(person, action, confirm=True)


async def know_ramps(page: PageContext, person: Person, bus: str, units: Iterable[int]) -> None:
    """Read the ramp parameters that were never read; a ramp stays unknown where the unit does not respond."""
    deadline = page.deadline(page.bus(bus))

    async def read(unit: int, numbers: list[int]) -> None:
        with suppress(Problem):
            await read_first(page.commands(bus).send, person, unit, numbers, deadline)

    missing = {unit: ramp_parameters_missing(page.unit(bus, unit)) for unit in units}
    await asyncio.gather(*(read(unit, numbers) for unit, numbers in missing.items() if numbers))


def change(page: PageContext, bus: str, unit: int, raw: int) -> SetpointChange:
    """What a new setpoint means for a unit."""
    limits, block = page.guards(bus).limits.of(unit), page.guards(bus).block_reason(unit)
    return change_of(page.bus(bus), page.unit(bus, unit), raw, limits, unix_now(), block=block)


def facts(page: PageContext, bus: str, unit: int) -> RiskInputs:
    """The inputs of the risk rules for a unit, without a ramp."""
    block = page.guards(bus).block_reason(unit)
    return facts_of(page.bus(bus), page.unit(bus, unit), unix_now(), block=block)


def keep_their_setpoint(
    page: PageContext, bus: str, taking_part: Iterable[int]
) -> tuple[list[tuple[str, Message]], list[str]]:
    """The units of a bus that are not part of a change: those that could take no setpoint now, each with the
    reason, and the names of the rest."""
    left_out, unchanged = [], []
    taking = set(taking_part)
    for unit in (number for number in page.bus(bus).units if number not in taking):
        name, obstacle = page.unit(bus, unit).settings.name, obstacle_of(facts(page, bus, unit))
        if obstacle is None:
            unchanged.append(name)
        else:
            left_out.append((name, obstacle))
    return left_out, unchanged

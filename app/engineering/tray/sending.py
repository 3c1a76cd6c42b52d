"""Sends what was reviewed of a change tray: all setpoints of the bus as one change, then the rest one by one.
A failure stops what follows.
"""

from __future__ import annotations

from dataclasses import dataclass

from app.core.web.admission.access import Person
from app.core.web.admission.arrival import Deadline
from app.engineering.tray.contents import PlaceScales, steps_of
from app.errors import Problem
from app.line.commands.catalogue import kind_of_command
from app.line.commands.service.command_service import CommandService
from app.line.commands.undo.changes import ValuePlace, Values, action_for
from app.line.commands.values import Scales
from app.line.live.state.bus_live import BusLive
from bus.contract import Result, UnitOutcome
from bus.instants import Monotonic
from bus.messages import Message

_DONE = ("verified", "acknowledged")


@dataclass(frozen=True, slots=True)
class TrayResult:
    """What became of one change. ``id``: of its command; ``part``: its result, or the reason why it was not
    sent."""

    place: ValuePlace
    raw: int
    id: str
    part: Result | UnitOutcome | Message

    @property
    def is_done(self) -> bool:
        """Whether the unit has taken it, so that it leaves the tray."""
        return not isinstance(self.part, Message) and self.part.outcome in _DONE


def first_id(id: str) -> str:
    """The id of the first command of a change."""
    return f"{id}-0"


async def send_changes(
    commands: CommandService,
    person: Person,
    bus: BusLive,
    changes: Values,
    id: str,
    made_at: Monotonic,
    scales: PlaceScales,
) -> list[TrayResult]:
    """The result of each change, in the order in which they were sent. ``id``: of the change; sent again, it
    gives the same results. ``made_at``: when the person confirmed it, from which the time of the first
    command counts. ``scales``: what they were shown with."""
    results: list[TrayResult] = []
    failed = False
    for step, values in enumerate(steps_of(changes)):
        key = f"{id}-{step}"
        if failed:
            parts: dict[ValuePlace, Result | UnitOutcome | Message] = dict.fromkeys(
                values, Message("tray_stopped_before")
            )
        else:
            deadline = _deadline(bus, values, made_at) if step == 0 else None
            shown_with = {place.unit: scales.get(place, {}) for place in values}
            parts = await _sent(commands, person, values, key, deadline, shown_with)
        these = [TrayResult(place, values[place], key, part) for place, part in parts.items()]
        failed = failed or not all(result.is_done for result in these)
        results += these
    return results


def _deadline(bus: BusLive, values: Values, made_at: Monotonic) -> Deadline:
    action = action_for(values)
    return Deadline(made_at, kind_of_command(action).timeout_s(action, bus))


async def _sent(
    commands: CommandService,
    person: Person,
    values: Values,
    id: str,
    deadline: Deadline | None,
    scales: Scales,
) -> dict[ValuePlace, Result | UnitOutcome | Message]:
    try:
        result = await commands.send(
            person,
            action_for(values),
            deadline=deadline,
            confirm=True,
            id=id,
            origin="change tray",
            scales=scales,
        )
    except Problem as problem:
        return dict.fromkeys(values, problem.message)
    by_unit = {part.unit: part for part in result.units} if len(values) > 1 else {}
    return {place: by_unit.get(place.unit, result) for place in values}

"""The change tray of a request's person: adding changes, judging them, sending them."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

from app.core.web.access import Person
from app.core.web.arrival import Deadline
from app.core.web.services import bus_service_of
from app.engineering.tray.contents import PlaceScales, TrayRow, Trays, setpoint_row, steps_of, value_row
from app.errors import Problem
from app.line.commands.catalogue import kind_of_command
from app.line.commands.page_context import BusPage
from app.line.commands.rules import reason_of
from app.line.commands.service import CommandService
from app.line.commands.undo import ValuePlace, Values, action_for
from app.line.commands.values import Scales, differs, scales_of
from app.line.live.bus_live import BusLive
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Result, UnitOutcome, UnitScale
from bus.instants import Monotonic, monotonic_now
from bus.messages import Message


class OwnTray:
    """The tray of one person for one bus."""

    def __init__(self, page: BusPage) -> None:
        self.page = page
        self._trays = bus_service_of(page.request, page.name, Trays)

    @property
    def changes(self) -> Values:
        """The changes of units that are still configured."""
        held = self._trays.changes(self.page.person.sender, monotonic_now())
        return {place: raw for place, raw in held.items() if place.unit in self.page.bus.units}

    @property
    def scales(self) -> PlaceScales:
        """The scales that showed the changes when they were added."""
        return self._trays.scales(self.page.person.sender)

    async def add(
        self, changes: Values, deadline: Deadline | None = None, scales: Scales | None = None
    ) -> None:
        """Add all changes or none. ``scales``: those that converted them, by unit; None: the present ones.

        Raise Problem for a change that this person could never send.
        """
        deadline = deadline or self.page.deadline()
        given = scales or {}
        shown_with = {
            place: {**scales_of(action_for({place: raw}), self.page.bus), **given}.get(place.unit, {})
            for place, raw in changes.items()
        }
        for place, raw in changes.items():
            if place.kind == "parameter" and place.number in PARAMETERS and PARAMETERS[place.number].secret:
                raise Problem(422, "invalid", Message.of("tray_secret", number=place.number))
            action = action_for({place: raw})
            await self.page.commands.check_for_later(self.page.person, action, deadline)
        self._trays.add(self.page.person.sender, changes, monotonic_now(), shown_with)

    def remove(self, changes: Values) -> None:
        """Remove changes, except those whose value has changed meanwhile."""
        self._trays.remove(self.page.person.sender, changes)

    def rows(self) -> list[TrayRow]:
        """Check every change against its unit's present state."""
        return tray_rows(self.page, self.changes, self.scales)

    async def learn(self) -> None:
        """Read the parameters that keypads may have changed, and the ramps that were never read, for the
        units that take commands now."""
        places = [place for place in self.changes if self.page.obstacle(place.unit) is None]
        numbers: dict[int, list[int]] = {}
        for place in places:
            if place.kind == "parameter":
                numbers.setdefault(place.unit, []).append(place.number)
        await asyncio.gather(
            self.page.know_ramps(place.unit for place in places if place.kind == "setpoint"),
            self._read(numbers.items()),
        )

    async def _read(self, numbers: Iterable[tuple[int, list[int]]]) -> None:
        deadline = self.page.deadline()
        for unit, those in numbers:
            with suppress(Problem):
                await self.page.commands.read(self.page.person, unit, those, deadline)


def tray_rows(page: BusPage, changes: Values, scales: PlaceScales) -> list[TrayRow]:
    """Check changes against the present state of units, in the order of sending, setpoints in floor order.

    ``scales``: those that showed the changes when they were added.
    """
    floor = {unit: at for at, unit in enumerate(page.bus.units)}
    values, rows = page.commands.undo.values_now(changes), list[TrayRow]()
    for step in steps_of(changes):
        for place, raw in sorted(step.items(), key=lambda change: floor[change[0].unit]):
            refusal = _refusal(page, place, raw, scales.get(place, {}))
            if place.kind == "setpoint":
                change, unit = page.change(place.unit, raw), page.bus.units[place.unit]
                rows.append(setpoint_row(place, raw, change, unit, refusal))
            else:
                rows.append(value_row(place, raw, values[place], page.bus, refusal))
    return rows


def _refusal(page: BusPage, place: ValuePlace, raw: int, added_with: UnitScale) -> Message | None:
    """Return the reason why a change, if confirmed, would be refused now."""
    if (obstacle := page.obstacle(place.unit)) is not None:
        return obstacle
    if differs(added_with, page.bus.units[place.unit]):
        return Message("tray_other_scale")
    try:
        page.check(action_for({place: raw}))
    except Problem as problem:
        return reason_of(problem)
    return None


_DONE = ("verified", "acknowledged")


@dataclass(frozen=True, slots=True)
class TrayResult:
    """The result of one change. ``id``: of its command; ``part``: the result, or why nothing was sent."""

    place: ValuePlace
    raw: int
    id: str
    part: Result | UnitOutcome | Message

    @property
    def is_done(self) -> bool:
        """Whether the unit has taken the change, which then leaves the tray."""
        return not isinstance(self.part, Message) and self.part.outcome in _DONE


def first_id(id: str) -> str:
    """Return the id of the first command of a tray that is sent with the id ``id``."""
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
    """Send changes: all setpoints as one command, then the rest one by one, until one fails.

    Return the result of each in that order. ``id``: of the form; sending it again gives the same results.
    ``made_at``: the time when the person confirmed, where the deadline of the first command starts.
    ``scales``: those that showed the changes.
    """
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

"""The change tray of the person of a request: its changes, what may be added, how each is now.

Sends what was reviewed of a change tray: all setpoints of the bus as one change, then the rest one by one.
A failure stops what follows.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

from app.core.web.admission.access import Person
from app.core.web.admission.arrival import Deadline
from app.core.web.services import bus_service_of
from app.engineering.tray.contents import Judge, PlaceScales, TrayRow, Trays, steps_of
from app.errors import Problem
from app.line.commands.catalogue import kind_of_command
from app.line.commands.forms.page_context import BusPage
from app.line.commands.rules import reason_of
from app.line.commands.service.command_service import CommandService
from app.line.commands.undo.changes import ValuePlace, Values, action_for
from app.line.commands.values import Scales, differs, scales_of
from app.line.live.bus_live import BusLive
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Action, Result, UnitOutcome
from bus.instants import Monotonic, monotonic_now
from bus.messages import Message


class OwnTray:
    """One person's tray of one bus."""

    def __init__(self, page: BusPage) -> None:
        self.page = page
        self._trays = bus_service_of(page.request, page.name, Trays)

    @property
    def changes(self) -> Values:
        """Its content, of units that are configured still."""
        held = self._trays.of(self.page.person.sender, monotonic_now())
        return {place: raw for place, raw in held.items() if place.unit in self.page.bus.units}

    @property
    def scales(self) -> PlaceScales:
        """What its changes were shown with when they were added."""
        return self._trays.scales_of(self.page.person.sender)

    async def add(
        self, changes: Values, deadline: Deadline | None = None, scales: Scales | None = None
    ) -> None:
        """Add changes, all of them or none. ``scales``: by unit what they were converted with, where it was
        not just now. Raises Problem for one that could never be sent by this person."""
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
        """Remove changes; one that has another value by now stays."""
        self._trays.remove(self.page.person.sender, changes)

    def rows(self) -> list[TrayRow]:
        """Every change as it stands now."""
        changes, page = self.changes, self.page
        values = page.commands.undo.values_now(changes)
        judge = Judge(page.bus, values, page.change, page.obstacle, self._refusal, self._other_scale)
        return judge.rows(changes)

    async def learn(self) -> None:
        """Read what the keypads may have changed of the parameters, and the ramps that were never read, of
        the units that take commands now."""
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

    def _other_scale(self, place: ValuePlace) -> Message | None:
        """Why a change is another value now than when it was added; None where it is the same."""
        added_with = self.scales.get(place, {})
        return Message("tray_other_scale") if differs(added_with, self.page.bus.units[place.unit]) else None

    def _refusal(self, action: Action) -> Message | None:
        """Why this command would be refused now, confirmed as it will be."""
        try:
            self.page.check(action)
        except Problem as problem:
            return reason_of(problem)
        return None


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

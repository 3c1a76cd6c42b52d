"""What a spare can be made from: a set of its section, one of a sister, a neighbour as it is now, a sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fastapi import UploadFile

from app.errors import Problem
from app.live.state import LiveState
from app.sets.keeper import SetKeeper
from app.sets.lookup import uploaded_rows
from app.sets.sides import Choice, choices, side
from app.sets.store import SetSummary
from app.swap.record import Source
from app.web.access import Person

SHEET = "sheet"
"""Nothing is stored: a person enters the values."""


@dataclass(frozen=True, slots=True)
class Offers:
    """``own``: sets of the section, newest first; ``sisters``: the newest and the golden set of every other
    unit, those of the same group first; ``neighbours``: the other units as they are now."""

    own: list[Choice]
    sisters: list[Choice]
    neighbours: list[Choice]

    @property
    def best(self) -> str:
        """What is chosen at first: the golden set, or the newest; nothing where the section has none."""
        golden = [choice.text for choice in self.own if choice.golden]
        return (golden or [choice.text for choice in self.own] or [""])[0]


def offers(live: LiveState, sets: Sequence[SetSummary], bus: str, unit: int) -> Offers:
    """Everything that helps the section ``unit``; ``sets`` newest first."""
    group = live.buses[bus].units[unit].settings.group
    every = choices(live, sets)
    own = [choice for choice in every if choice.taken_at is not None and _is(choice, bus, unit)]
    others = [choice for choice in every if not _is(choice, bus, unit)]
    others.sort(key=lambda choice: (choice.bus != bus, _group(live, choice) != group))
    return Offers(
        own,
        _newest_and_golden([choice for choice in others if choice.taken_at is not None]),
        [choice for choice in others if choice.taken_at is None],
    )


async def source_of(
    person: Person,
    keeper: SetKeeper,
    live: LiveState,
    bus: str,
    unit: int,
    text: str,
    file: UploadFile | None,
) -> Source | None:
    """What was chosen, as a stored set: a neighbour is read now, a file is kept. None: the sheet.

    Raises Problem 404, 422 or 504 in words.
    """
    if file is not None and file.filename:
        rows = await uploaded_rows(unit, file)
        kept = await keeper.keep(person, bus, [rows], file.filename[:80], "", "from a file")
        return Source(kept.id, rows.unit)
    if text == SHEET:
        return None
    if not text:
        raise Problem(422, "invalid", "choose what the spare shall become; nothing was begun")
    chosen = await side(text, keeper, live)
    if chosen.kind == "set":
        return Source(int(chosen.of), chosen.unit)
    name = f"for the swap of unit {unit}"
    return Source((await keeper.take(person, chosen.of, [chosen.unit], name, "")).id, chosen.unit)


def _is(choice: Choice, bus: str, unit: int) -> bool:
    return (choice.bus, choice.unit) == (bus, unit)


def _group(live: LiveState, choice: Choice) -> str | None:
    bus = live.buses.get(choice.bus)
    unit = None if bus is None else bus.units.get(choice.unit)
    return None if unit is None else unit.settings.group


def _newest_and_golden(sets: Sequence[Choice]) -> list[Choice]:
    seen: set[tuple[str, int]] = set()
    found: list[Choice] = []
    for choice in sets:
        if choice.golden or (choice.bus, choice.unit) not in seen:
            found.append(choice)
        seen.add((choice.bus, choice.unit))
    return found

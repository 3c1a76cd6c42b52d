"""The sets that a unit can be restored from: its own first, those of other units apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.live.state.bus_live import LiveState
from app.sets.sides import SideOption, choices
from app.sets.store import SetSummary


@dataclass(frozen=True, slots=True)
class Offers:
    """``own``: sets of the unit, newest first; ``sisters``: the newest and the golden set of every other
    unit, those of the same group first; ``neighbours``: the other units as they are now."""

    own: list[SideOption]
    sisters: list[SideOption]
    neighbours: list[SideOption]

    @property
    def golden(self) -> str:
        """The golden set of the unit; empty where it has none."""
        return next((choice.text for choice in self.own if choice.golden), "")

    @property
    def best(self) -> str:
        """The reference of the unit: its golden set, else its newest; empty where it has none."""
        return self.golden or next((choice.text for choice in self.own), "")


def offers(live: LiveState, sets: Sequence[SetSummary], bus: str, unit: int) -> Offers:
    """Everything that helps ``unit``; ``sets`` newest first."""
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


def _is(choice: SideOption, bus: str, unit: int) -> bool:
    return (choice.bus, choice.unit) == (bus, unit)


def _group(live: LiveState, choice: SideOption) -> str | None:
    bus = live.buses.get(choice.bus)
    unit = None if bus is None else bus.units.get(choice.unit)
    return None if unit is None else unit.settings.group


def _newest_and_golden(sets: Sequence[SideOption]) -> list[SideOption]:
    seen: set[tuple[str, int]] = set()
    found: list[SideOption] = []
    for choice in sets:
        if choice.golden or (choice.bus, choice.unit) not in seen:
            found.append(choice)
        seen.add((choice.bus, choice.unit))
    return found

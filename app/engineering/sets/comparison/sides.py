"""The two sides of a comparison as an address can name them, and those that a unit can be restored from.

``set:12:3`` is unit 3 of set 12, ``golden:dry-end:3`` the golden set of unit 3, ``live:dry-end:3`` its values
as last read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.core.web.api.shape import parse_integer
from app.engineering.sets.lookup import set_or_404, unit_rows_or_404
from app.engineering.sets.model import ParameterSetSummary, UnitRows
from app.engineering.sets.saving.reading import known_rows
from app.engineering.sets.store import SetStore
from app.errors import Problem, or_404
from app.line.live.lookup import unit_or_404
from app.line.live.state.bus_live import LiveState
from bus.instants import UnixTime
from bus.messages import Message


@dataclass(frozen=True, slots=True)
class Side:
    """One side. ``kind``: set, golden or live; ``of``: the set's number or the bus."""

    kind: str
    of: str
    unit: int
    rows: UnitRows


@dataclass(frozen=True, slots=True)
class SideOption:
    """A side that can be chosen: ``text`` as an address names it, ``name`` and ``group`` of its section,
    empty and None where it is not configured. What a stored set has is None or empty of the live unit."""

    text: str
    bus: str
    unit: int
    name: str
    group: str | None
    taken_at: UnixTime | None = None
    title: str = ""
    golden: bool = False
    origin: str = ""


def choices(live: LiveState, sets: Sequence[ParameterSetSummary]) -> list[SideOption]:
    """Every unit as last read, then every unit of every stored set, newest first."""
    units = {
        (bus, unit): one.settings for bus, line in live.buses.items() for unit, one in line.units.items()
    }
    found = [
        SideOption(f"live:{bus}:{unit}", bus, unit, settings.name, settings.group)
        for (bus, unit), settings in units.items()
    ]
    for one in sets:
        for unit in one.units:
            known = units.get((one.bus, unit))
            place = (one.bus, unit, known.name if known else "", known.group if known else None)
            taken = (one.taken_at, one.name, unit in one.golden_for, one.origin)
            found.append(SideOption(f"set:{one.id}:{unit}", *place, *taken))
    return found


async def side(text: str, store: SetStore, live: LiveState) -> Side:
    """Find what ``text`` names. Raises Problem 404 or 422 in words."""
    kind, _, rest = text.partition(":")
    of, _, number = rest.rpartition(":")
    unit = parse_integer(number)
    if kind not in ("set", "golden", "live") or not of or unit is None:
        known = "set:12:3, golden:BUS:3 or live:BUS:3"
        raise Problem(422, "invalid", Message.of("no_such_side", text=text, known=known))
    return Side(kind, of, unit, await _rows(kind, of, unit, store, live))


async def _rows(kind: str, of: str, unit: int, store: SetStore, live: LiveState) -> UnitRows:
    if kind == "set":
        number = parse_integer(of)
        if number is None:
            raise Problem(422, "invalid", Message.of("not_a_set_number", text=of))
        return unit_rows_or_404(await set_or_404(store, number), unit)
    if kind == "live":
        return known_rows(unit_or_404(live, of, unit))
    golden = (await store.golden(of)).get(unit)
    return or_404(golden, "unknown_set", Message.of("no_golden_set", unit=unit, bus=of))


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


def offers(live: LiveState, sets: Sequence[ParameterSetSummary], bus: str, unit: int) -> Offers:
    """Everything that helps ``unit``; ``sets`` newest first."""
    group = live.buses[bus].units[unit].settings.group
    every = choices(live, sets)
    own = [one for one in every if one.taken_at is not None and (one.bus, one.unit) == (bus, unit)]
    others = [one for one in every if (one.bus, one.unit) != (bus, unit)]
    others.sort(key=lambda one: (one.bus != bus, one.group != group))
    sisters: list[SideOption] = []
    seen: set[tuple[str, int]] = set()
    for one in others:
        if one.taken_at is not None and (one.golden or (one.bus, one.unit) not in seen):
            sisters.append(one)
            seen.add((one.bus, one.unit))
    return Offers(own, sisters, [one for one in others if one.taken_at is None])

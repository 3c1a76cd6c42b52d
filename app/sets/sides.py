"""The two sides of a comparison as an address can name them, and those that a unit can be restored from.

``set:12:3`` is unit 3 of set 12, ``golden:dry-end:3`` the golden set of unit 3, ``live:dry-end:3`` its values
as last read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.errors import Problem, or_404
from app.live.lookup import unit_or_404
from app.live.state.bus_live import LiveState
from app.sets.lookup import set_or_404, unit_rows_or_404
from app.sets.model import ParameterSetSummary, UnitRows
from app.sets.reading import known_rows
from app.sets.store import SetStore
from app.web.shape import parse_integer
from bus.instants import UnixTime
from bus.messages import Message
from bus.settings import UnitSettings


@dataclass(frozen=True, slots=True)
class Side:
    """One side. ``kind``: set, golden or live; ``of``: the set's number or the bus."""

    kind: str
    of: str
    unit: int
    rows: UnitRows


@dataclass(frozen=True, slots=True)
class SideOption:
    """A side that can be chosen: ``text`` as an address names it, ``unit`` and ``name`` of its section,
    ``taken_at``, ``title`` and ``origin`` of a stored set (None: the live unit)."""

    text: str
    bus: str
    unit: int
    name: str
    taken_at: UnixTime | None = None
    title: str = ""
    golden: bool = False
    origin: str = ""

    @property
    def place(self) -> tuple[str, int]:
        return self.bus, self.unit


def choices(live: LiveState, sets: Sequence[ParameterSetSummary]) -> list[SideOption]:
    """Every unit as last read, then every unit of every stored set, newest first."""
    found = [
        SideOption(f"live:{bus}:{number}", bus, number, unit.settings.name)
        for bus, line in live.buses.items()
        for number, unit in line.units.items()
    ]
    return found + [_stored(live, one, unit) for one in sets for unit in one.units]


def _stored(live: LiveState, one: ParameterSetSummary, unit: int) -> SideOption:
    known = _configured(live, one.bus, unit)
    name, is_golden = known.name if known else "", unit in one.golden_for
    text = f"set:{one.id}:{unit}"
    return SideOption(text, one.bus, unit, name, one.taken_at, one.name, is_golden, one.origin)


def _configured(live: LiveState, bus: str, unit: int) -> UnitSettings | None:
    found = live.buses[bus].units.get(unit) if bus in live.buses else None
    return found.settings if found else None


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
    own = [choice for choice in every if choice.taken_at is not None and choice.place == (bus, unit)]
    others = [choice for choice in every if choice.place != (bus, unit)]

    def is_distant(choice: SideOption) -> tuple[bool, bool]:
        settings = _configured(live, choice.bus, choice.unit)
        return choice.bus != bus, settings is None or settings.group != group

    others.sort(key=is_distant)
    stored = [choice for choice in others if choice.taken_at is not None]
    return Offers(own, _newest_and_golden(stored), [one for one in others if one.taken_at is None])


def _newest_and_golden(sets: Sequence[SideOption]) -> list[SideOption]:
    seen: set[tuple[str, int]] = set()
    found: list[SideOption] = []
    for choice in sets:
        if choice.golden or choice.place not in seen:
            found.append(choice)
        seen.add(choice.place)
    return found

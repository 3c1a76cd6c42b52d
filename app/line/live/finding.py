"""Finds units by their address, their name, their group and what is wired to them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from app.core.find.finders import FoundPlace, Search, matched
from app.line.live.screen.fields import unit_key
from app.line.live.state.bus_live import BusLive, LiveState, UnitLive


def unit_names(unit: UnitLive) -> list[str]:
    """What people call it, and its address."""
    settings = unit.settings
    wired = (*settings.labels.input.values(), *settings.labels.output.values(), settings.labels.analog)
    return [settings.name, str(settings.id), settings.group, *wired]


class UnitFinder:
    def __init__(self, live: LiveState) -> None:
        self._live = live

    async def __call__(self, search: Search) -> Iterable[FoundPlace]:
        """Each unit of a bus that is here."""
        return [
            place
            for bus in self._live.buses.values()
            for unit in bus.units.values()
            for place in _of_unit(search, bus, unit)
        ]


def _of_unit(search: Search, bus: BusLive, unit: UnitLive) -> Iterator[FoundPlace]:
    settings, name = unit.settings, bus.settings.name
    detail = " · ".join(part for part in (str(settings.id), settings.group, name) if part)
    href = f"/units/{unit_key(name, settings.id)}"
    yield from matched(search, FoundPlace(settings.name, href, detail, is_name=True), *unit_names(unit))

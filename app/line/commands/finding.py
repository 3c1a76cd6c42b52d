"""Finds parameters by number, name or meaning, of the unit that is named with them or whose page is open."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from app.core.find.finders import MAX_OF_KIND, FoundPlace, Search, missing, rank
from app.line.live.bus_live import LiveState, UnitLive
from app.line.live.fields import unit_key
from bus.catalogue.parameter import Parameter
from bus.catalogue.parameters import PARAMETERS
from bus.messages import parameter_name


class _Page(NamedTuple):
    key: str
    unit: UnitLive


class ParameterFinder:
    def __init__(self, live: LiveState) -> None:
        self._live = live

    async def __call__(self, search: Search) -> Iterable[FoundPlace]:
        """Of "coater ramp", the ramp of Coater; of "9" alone, that of the unit of the page, or the first."""
        pages = [
            _Page(unit_key(name, number), unit)
            for name, bus in self._live.buses.items()
            for number, unit in bus.units.items()
        ]
        near = [page for page in pages if search.near.startswith(f"/units/{page.key}")]
        return [
            place
            for parameter in PARAMETERS.values()
            for place in _of_parameter(search, parameter, pages, near or pages[:1])
        ]


def _of_parameter(
    search: Search, parameter: Parameter, pages: list[_Page], near: list[_Page]
) -> Iterator[FoundPlace]:
    texts = (search.language.t(text) for text in (parameter.name, parameter.meaning))
    names = [str(parameter.number), parameter.name, *texts]
    of_unit = missing(search.words, names)
    if len(of_unit) == len(search.words):
        return
    how_well = rank([word for word in search.words if word not in of_unit], names) or 0
    named = [page for page in pages if rank(of_unit, page.unit.names) is not None] if of_unit else near
    title = search.language.t(parameter_name(parameter.number))
    for page in named[:MAX_OF_KIND]:
        href = f"/units/{page.key}/parameters#parameter-{parameter.number}"
        yield FoundPlace(title, href, page.unit.settings.name, how_well + 1)

"""Commands to units: checked, recorded, sent, and read back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from typing import NamedTuple

from app.core.database import Database
from app.core.find.finders import MAX_OF_KIND, Finders, FoundPlace, Search, missing, rank
from app.core.web.templating import Templates
from app.feature import Feature, Services
from app.line.commands import api, safeguards_api, trace_api
from app.line.commands.catalogue import ROLES_BY_COMMAND
from app.line.commands.pages import bus, line, parameters, speed, unit
from app.line.commands.record import CommandRecord
from app.line.commands.safeguards import ACTS, Safeguards
from app.line.commands.service import CommandService
from app.line.feed.channel import Channel
from app.line.live.bus_live import BusLive, LiveState, UnitLive
from app.line.live.fields import unit_key
from app.line.live.hub import Hub
from app.line.live.sources import Sources
from app.people.audit.log import EventLog
from app.people.auth.accounts import Accounts
from app.people.auth.rights import Rights
from bus.catalogue.parameters import PARAMETERS, Parameter
from bus.instants import unix_now
from bus.messages import parameter_name


def make(services: Services) -> None:
    services[Templates].permit(ROLES_BY_COMMAND)
    services[Finders].add("find_parameters", ParameterFinder(services[LiveState]))
    database, events, rights, hub = services[Database], services[EventLog], services[Rights], services[Hub]
    record = CommandRecord(events, database, unix_now)
    for name, of_bus in services.buses.items():
        guards = Safeguards(
            name,
            of_bus[BusLive].units,
            database,
            events,
            control_required=services.settings.site.control,
            find=services[Accounts].find,
            rights=rights,
        )
        guards.on_block(partial(hub.refresh_unit, name))
        guards.on_control(hub.show_control)
        services[Sources].guards[name] = guards
        services.lifespan.add(f"safeguards of {name}", start=of_bus.add(guards).load)
        live, channel = of_bus[BusLive], of_bus[Channel]
        of_bus.add(CommandService(live, channel, record, guards, rights))
    all_guards = services.of_buses(Safeguards).values()
    services[Templates].parts["controls"] = lambda *_: [guards.bus_control() for guards in all_guards]


class _Page(NamedTuple):
    """The page of a unit."""

    key: str
    unit: UnitLive


class ParameterFinder:
    """The finder of parameters by number, name or meaning, of the unit named with them or whose page is
    open."""

    def __init__(self, live: LiveState) -> None:
        self._live = live

    async def __call__(self, search: Search) -> Iterable[FoundPlace]:
        """Find the ramp of Coater for "coater ramp", and for "9" that of the page's unit, or the first."""
        pages = [
            _Page(unit_key(name, number), unit)
            for name, bus in self._live.buses.items()
            for number, unit in bus.units.items()
        ]
        near = [page for page in pages if search.near.startswith(f"/units/{page.key}")]
        return [
            place
            for parameter in PARAMETERS.values()
            for place in _places_of(search, parameter, pages, near or pages[:1])
        ]


def _places_of(
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


FEATURE = Feature(
    make,
    (
        api.router,
        safeguards_api.router,
        trace_api.router,
        line.router,
        speed.router,
        parameters.router,
        bus.router,
        unit.router,
    ),
    ACTS,
)

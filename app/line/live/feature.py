"""The present state of every unit, and the record of its changes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from app.core.find.finders import Finders, FoundPlace, Search, matched
from app.core.web.services import Registry
from app.feature import Feature, Services
from app.line.history.service import History
from app.line.live.api import routes
from app.line.live.bus_live import BusLive, LiveState, UnitLive
from app.line.live.change_recorder import ChangeRecorder, LineEvent
from app.line.live.fields import unit_key
from app.people.audit.log import EventLog
from bus.instants import unix_now


class UnitFinder:
    """Finds units by their name, address, group and wiring."""

    def __init__(self, live: LiveState) -> None:
        self._live = live

    async def __call__(self, search: Search) -> Iterable[FoundPlace]:
        return [
            place
            for bus in self._live.buses.values()
            for unit in bus.units.values()
            for place in _found(search, bus, unit)
        ]


def _found(search: Search, bus: BusLive, unit: UnitLive) -> Iterator[FoundPlace]:
    settings, name = unit.settings, bus.settings.name
    detail = " · ".join(part for part in (str(settings.id), settings.group, name) if part)
    href = f"/units/{unit_key(name, settings.id)}"
    yield from matched(search, FoundPlace(settings.name, href, detail, is_name=True), *unit.names)


def make(services: Services) -> None:
    live = services.add(LiveState(services.settings.bus, unix_now()))
    services[Finders].add("find_units", UnitFinder(live))
    recorder = _make_recorder(services, services, None)
    services[History].on_fault(lambda kind, what, at: recorder.note(LineEvent(kind, None, at, what, "", "")))
    for name, bus in services.buses.items():
        bus.add(live.buses[name])
        _make_recorder(services, bus, name)


def _make_recorder(services: Services, owner: Registry, bus: str | None) -> ChangeRecorder:
    """``owner``: the site, or one bus."""
    recorder = owner.add(ChangeRecorder(services[EventLog], bus))
    name = f"changes of {bus or 'the site'}"
    services.lifespan.add(name, recorder.follow, finish=recorder.recorded)
    return recorder


FEATURE = Feature(make, (routes.router,))

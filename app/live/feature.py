"""The present state of every unit, and the record of its changes."""

from __future__ import annotations

from app.audit.log import EventLog
from app.feature import Feature, Services
from app.find.finders import Finders
from app.history.service import History
from app.live.api import routes
from app.live.change_recorder import ChangeRecorder
from app.live.changes import LineEvent
from app.live.finding import UnitFinder
from app.live.state.bus_live import LiveState
from app.web.services import Registry
from bus.instants import unix_now


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

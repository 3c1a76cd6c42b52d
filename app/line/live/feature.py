"""The present state of every unit, and the record of its changes."""

from __future__ import annotations

from app.core.find.finders import Finders
from app.core.web.services import Registry
from app.feature import Feature, Services
from app.line.history.service import History
from app.line.live.api import routes
from app.line.live.change_recorder import ChangeRecorder
from app.line.live.changes import LineEvent
from app.line.live.finding import UnitFinder
from app.line.live.state.bus_live import LiveState
from app.people.audit.log import EventLog
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

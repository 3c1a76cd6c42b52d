"""Makes the present state of every unit, the record of its changes, and what sends them to browsers."""

from __future__ import annotations

from functools import partial

from app.core.database.files import Reserve
from app.core.find.finders import Finders
from app.core.messages import DEFAULT
from app.core.web.services import Registry
from app.core.web.templating import Templates
from app.feature import Feature, Services
from app.line.history.service import History, status_words
from app.line.history.status import store_notice
from app.line.live import hub, pages
from app.line.live.api import routes
from app.line.live.api.routes import LineStream
from app.line.live.api.view import LineView
from app.line.live.bus_live import LiveState
from app.line.live.change_recorder import ChangeRecorder, LineEvent, OnsetLookup
from app.line.live.fields import Translator
from app.line.live.hub import Hub
from app.line.live.sources import Notice, Sources
from app.line.live.unit_finder import find_units, find_wiring
from app.people.audit.anchor import Anchoring, anchor_notice
from app.people.audit.log import EventLog
from bus.instants import unix_now


def make(services: Services) -> None:
    live = services.add(LiveState(services.settings.bus, unix_now()))
    finders = services[Finders]
    finders.add("find_units", partial(find_units, live))
    finders.add("find_wiring", partial(find_wiring, live))
    history, recorder = services[History], _make_recorder(services, services, None)
    history.on_fault(lambda kind, what, at: recorder.note(LineEvent(kind, None, at, what, "", "")))
    for name, bus in services.buses.items():
        bus.add(live.buses[name])
        _make_recorder(services, bus, name)
    _make_screens(services, live, services.add(_sources_of_records(services)))


def _make_recorder(services: Services, owner: Registry, bus: str | None) -> ChangeRecorder:
    """Make the recorder of the site, or of one bus, which is its ``owner``."""
    recorder = owner.add(ChangeRecorder(services[EventLog], bus))
    name = f"changes of {bus or 'the site'}"
    services.lifespan.add(name, recorder.follow, finish=recorder.recorded)
    return recorder


def _sources_of_records(services: Services) -> Sources:
    """Return the sources that know what is wrong with the records; later features add theirs."""
    history, anchoring, reserve = services[History], services[Anchoring], services[Reserve]
    notices: list[Notice] = [
        lambda formats, now: store_notice(history.status, formats, now),
        lambda formats, now: anchor_notice(anchoring.status, formats, now),
        lambda _formats, _now: reserve.notice,
    ]
    return Sources(notices=notices, history_fault=lambda: history.status.message)


def _make_screens(services: Services, live: LiveState, sources: Sources) -> None:
    """Make what sends browsers and programs the changes."""
    templates, lifespan = services[Templates], services.lifespan
    english = Translator(templates.languages[DEFAULT], templates.formats(DEFAULT))
    view = services.add(LineView(services.settings.site.name, live, sources, english))
    stream = services.add(LineStream(view, unix_now))
    lifespan.add("stream", stream.follow)
    hub = services.add(Hub(live, sources, templates, unix_now))
    lifespan.add("browsers", hub.beat)
    words = partial(status_words, services[History])
    onsets = services.add(OnsetLookup(live, words, hub.refresh_unit, unix_now))
    lifespan.add("onsets", onsets.follow)


FEATURE = Feature(make, (routes.router, routes.document_router, hub.router, pages.router))

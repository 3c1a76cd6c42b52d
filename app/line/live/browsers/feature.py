"""Everything that browsers and programs are sent as it changes."""

from __future__ import annotations

from functools import partial

from app.core.database.files import Reserve
from app.core.messages import DEFAULT
from app.core.web.rendering.templating import Templates
from app.engineering.recipes.book import RecipeBook
from app.engineering.sets.drift import BusDrift
from app.feature import Feature, Services
from app.line.alarms.alarm import Alarm
from app.line.alarms.api import AlarmShown, alarm_json
from app.line.alarms.line_alarms import AlarmBanner, LineAlarms
from app.line.commands.safeguards import Safeguards
from app.line.feed.bus_feed import BusFeed
from app.line.history.service import History, status_words
from app.line.history.status import store_notice
from app.line.live import pages, socket
from app.line.live.api import stream_document
from app.line.live.api.stream import LineStream
from app.line.live.api.stream_document import AlarmType
from app.line.live.api.view import LineView
from app.line.live.bus_live import LiveState
from app.line.live.fields import Translator
from app.line.live.hub import Hub
from app.line.live.onset_lookup import OnsetLookup
from app.line.live.sources import Sources
from app.people.audit.anchor import Anchoring, anchor_notice
from app.system.peers.board import LineTiles
from bus.instants import UnixTime, unix_now


def make(services: Services) -> None:
    live, history, templates = services[LiveState], services[History], services[Templates]
    lifespan = services.lifespan
    sources = _make_sources(services)
    english = Translator(templates.languages[DEFAULT], templates.formats(DEFAULT))
    view = services.add(LineView(services.settings.site.name, live, sources, english))
    stream = services.add(LineStream(view, unix_now))
    lifespan.add("stream", stream.follow)
    services.add(AlarmType(AlarmShown))
    alarms = services[LineAlarms]
    alarms.subscribe(partial(_stream_alarm, stream, alarms))
    watchers = {name: feed.watch for name, feed in services.of_buses(BusFeed).items()}
    hub = services.add(Hub(live, sources, templates, watchers, unix_now))
    lifespan.add("browsers", hub.beat)
    onsets = services.add(OnsetLookup(live, partial(status_words, history), hub.refresh_unit, unix_now))
    lifespan.add("onsets", onsets.follow)


def _make_sources(services: Services) -> Sources:
    history = services[History]
    return Sources(
        guards=services.of_buses(Safeguards),
        drift=services.of_buses(BusDrift),
        recipes=services[RecipeBook],
        alarms=services[AlarmBanner],
        lines=services[LineTiles],
        notices=partial(_notices, history, services[Anchoring], services[Reserve]),
        history_fault=lambda: history.status.message,
    )


def _stream_alarm(stream: LineStream, alarms: LineAlarms, alarm: Alarm) -> None:
    stream.add("alarm", alarm.definition.bus, partial(alarm_json, alarms, alarm))


def _notices(
    history: History,
    anchoring: Anchoring,
    reserve: Reserve,
    translator: Translator,
    now: UnixTime,
) -> str:
    """Faults of the records, in the reader's language; mostly none."""
    found = (
        store_notice(history.status, translator.formats, now),
        anchor_notice(anchoring.status, translator.formats, now),
        reserve.notice,
    )
    return " ".join(translator.t(notice) for notice in found if notice is not None)


FEATURE = Feature(make, (stream_document.router, socket.router, pages.router))

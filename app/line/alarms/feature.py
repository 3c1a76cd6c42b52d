"""The feature of alarms: those of each bus and of the site, their journal and its figures."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from app.core.database import Database
from app.core.find.finders import Finders, FoundPlace, Search, matched
from app.core.messages import Language
from app.core.web.access import Caller
from app.core.web.services import Registry
from app.core.web.templating import Templates
from app.feature import Feature, Services
from app.line.alarms import api, own_alarms, own_pages, pages
from app.line.alarms.acts import ACTS
from app.line.alarms.alarm import Alarm
from app.line.alarms.api import AlarmShown, alarm_json
from app.line.alarms.bus_alarms import BusAlarms, control_left_by
from app.line.alarms.journal import AlarmStore
from app.line.alarms.line_alarms import AlarmBanner, ExpiryWatch, LineAlarms, SiteAlarms
from app.line.alarms.own_alarms import OwnAlarmBook
from app.line.alarms.simulation import Simulator
from app.line.conditions.catalogue import AUDIT_DEGRADED, DISK_LOW, EVENTS_NOT_ARCHIVED, HISTORY_DEGRADED
from app.line.history.service import History
from app.line.live.api.routes import AlarmType, LineStream
from app.line.live.bus_live import BusLive
from app.line.live.fields import Fields, Translator
from app.line.live.hub import Hub
from app.line.live.sources import Sources, UnitGuards
from app.people.audit.anchor import Anchoring, AnchorStatus
from app.people.audit.archive import EventArchive
from app.people.audit.log import EventLog
from app.people.auth.accounts import Accounts
from bus.instants import monotonic_now
from bus.messages import Message


async def _find(alarms: LineAlarms, search: Search) -> Iterable[FoundPlace]:
    """Find the alarms that are not normal."""
    found: list[FoundPlace] = []
    for alarm in alarms.present():
        definition, t = alarm.definition, search.language.t
        place = alarms.place(definition.bus, definition.unit)
        name, state = t(definition.name), t(alarm.state_text)
        label = f"{place} · {name}" if place else name
        found += matched(search, FoundPlace(label, f"/alarms/{alarm.id}", state), name, place, state)
    return found


def make(services: Services) -> None:
    settings, database, events = services.settings, services[Database], services[EventLog]
    store = AlarmStore(database)
    for name, bus in services.buses.items():
        _make_of_bus(services, name, bus, store)
    of_site = services.add(_alarms_of_site(services, store))
    of_buses = services.of_buses(BusAlarms)
    alarms = services.add(LineAlarms(of_buses, of_site, store, events))
    # The site's own alarms go first: the state of each is loaded after its definition.
    book = services.add(OwnAlarmBook(settings.alarm, settings.bus, alarms, database, events))
    services.lifespan.add("own alarms", start=book.load)
    follow = [of_site.follow, *(of.follow for of in of_buses.values())]
    services.lifespan.add("alarms", *follow, start=alarms.load, end=alarms.write)
    services[Finders].add("find_alarms", partial(_find, alarms))
    services.add(Simulator(services[History]))
    _add_banner(services, AlarmBanner(alarms))
    hub = services[Hub]
    alarms.subscribe(lambda alarm: hub.show_alarm(alarm.definition.bus, alarm.definition.unit))
    services.add(AlarmType(AlarmShown))
    alarms.subscribe(partial(_stream, services[LineStream], alarms))


def _make_of_bus(services: Services, name: str, bus: Registry, store: AlarmStore) -> None:
    settings, sources = services.settings, services[Sources]
    own = [alarm for alarm in settings.alarm if alarm.bus == name]
    alarms = BusAlarms(
        bus[BusLive],
        own,
        store,
        lambda unit: bool(sources.drift[name].differing(unit)),
        left_control=partial(_control_left, services, sources.guards[name]),
        tuned=settings.built_in_alarm,
    )
    bus.add(alarms)


def _alarms_of_site(services: Services, store: AlarmStore) -> SiteAlarms:
    settings, history, anchoring = services.settings, services[History], services[Anchoring]
    tls = settings.server.tls
    authorities = {*settings.notify.certificates, *((tls.client_ca,) if tls and tls.client_ca else ())}
    expiry = ExpiryWatch(
        services[Accounts].tokens, authorities, certificates=(tls.certificate,) if tls else ()
    )
    services.lifespan.add("expiry", expiry.follow)
    site = SiteAlarms(store, tuned=settings.built_in_alarm)
    site.watch("history_degraded", lambda: HISTORY_DEGRADED.holds(history.status.state))
    site.watch("disk_low", lambda: DISK_LOW.holds(history.status.state))
    site.watch("audit_degraded", lambda: _is_degraded(anchoring.status))
    site.watch("certificate_expiring", lambda: expiry.certificate)
    site.watch("token_expiring", lambda: expiry.token)
    site.watch("events_not_archived", lambda: EVENTS_NOT_ARCHIVED.holds(services[EventArchive].failing))
    return site


def _is_degraded(anchor: AnchorStatus) -> bool:
    return AUDIT_DEGRADED.holds(anchor != AnchorStatus(since=anchor.since))


def _control_left(services: Services, guards: UnitGuards) -> Message | None:
    holding = guards.holding()
    if holding is None:
        return None
    return control_left_by(holding.holder, holding.used_at, services[Hub].people(), monotonic_now())


def _add_banner(services: Services, banner: AlarmBanner) -> None:
    templates = services[Templates]

    def alarms_in(_: Caller | None, language: Language) -> Fields:
        return banner.banner(Translator(language, templates.formats(language.tag)))

    services[Sources].show_alarms(banner.banner, banner.unit_fields)
    templates.parts["head_alarms"] = alarms_in


def _stream(stream: LineStream, alarms: LineAlarms, alarm: Alarm) -> None:
    stream.add("alarm", alarm.definition.bus, partial(alarm_json, alarms, alarm))


FEATURE = Feature(
    make,
    (own_pages.router, own_alarms.router, api.router, pages.router),
    acts=ACTS,
)

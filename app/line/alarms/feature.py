"""The feature of alarms: those of each bus and of the site, their journal and its figures; and the page of
the alarms that the site defines, with the form for one and its simulation over stored history."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Annotated, Any, NamedTuple, cast, get_args
from urllib.parse import urlencode

from fastapi import APIRouter, Form, Query
from pydantic import BaseModel, Field
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.database import Database
from app.core.find.finders import Finders, FoundPlace, Search, matched
from app.core.messages import Language
from app.core.web.access import Caller, Engineer, Person
from app.core.web.routes import GuardedRoute
from app.core.web.services import Registry, service_of
from app.core.web.shape import parse_integer
from app.core.web.templating import Templates, render, templates_of
from app.errors import Problem
from app.feature import Feature, Services
from app.line.alarms import api, own_alarms, pages
from app.line.alarms.acts import ACTS, ADD_OWN, REMOVE_OWN
from app.line.alarms.alarm import Alarm
from app.line.alarms.api import AlarmShown, alarm_json
from app.line.alarms.bus_alarms import BusAlarms, control_left_by
from app.line.alarms.journal import AlarmStore
from app.line.alarms.line_alarms import AlarmBanner, ExpiryWatch, LineAlarms, SiteAlarms
from app.line.alarms.own_alarms import OwnAlarmBook, OwnBook, SimulatorOf, WrittenText
from app.line.alarms.own_condition import proposed
from app.line.alarms.pages import SEE_OTHER, TypedReason, given_reason
from app.line.alarms.settings import OwnValue
from app.line.alarms.simulation import AlarmSimulation, Simulator
from app.line.conditions.catalogue import AUDIT_DEGRADED, DISK_LOW, EVENTS_NOT_ARCHIVED, HISTORY_DEGRADED
from app.line.history.api import HistoryOf
from app.line.history.series import values
from app.line.history.series.values import VALUES
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
from bus.instants import DAY_S, monotonic_now, unix_now
from bus.messages import Message, term
from bus.settings import UnitSettings
from bus.validation import escaped

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

SPANS = (1, 7, 31)
_NUMBERS = ("above", "below", "deadband", "change_per_s")
_DELAYS = ("on_delay_s", "off_delay_s")
_TEXTS = ("cause", "consequence", "response")
_LABELS = {
    "name": "Name",
    "priority": "Priority",
    "above": "Above",
    "below": "Below",
    "change_per_s": "Change per second",
    "state": "State",
    "deadband": "Deadband",
    "on_delay_s": "On-delay, s",
    "off_delay_s": "Off-delay, s",
}
"""The label of the field for a key of ``[[alarm]]``."""
_FIELD_OF = {
    "setting_alarm_of_bit": ("state", "own_alarm_of_bit"),
    "setting_alarm_of_number": ("state", "own_alarm_of_number"),
    "setting_alarm_one_state": ("state", "own_alarm_one_state"),
    "setting_alarm_one_limit": ("above", "own_alarm_one_limit"),
    "setting_alarm_deadband_of_rate": ("deadband", "own_alarm_deadband_of_rate"),
    "setting_alarm_deadband_wide": ("deadband", "own_alarm_deadband_wide"),
    "setting_alarm_limits_reversed": ("below", "own_alarm_limits_reversed"),
}
"""The field that a person corrects for a fault of several keys, and the text with the names of the fields."""
UNNAMED = term("New alarm")
"""The name of an alarm that is simulated before it has one."""
_WITHOUT_FIELD = {"realarm_s", "latch"}
WrittenField = Annotated[str, Field(max_length=80)]


class OwnValueWords(NamedTuple):
    """The name of a value in a reader's language, by the label of the unit if it has one, and its unit of
    measure, empty if none is configured."""

    name: str
    measure: str


class WrittenAlarm(BaseModel):
    """The form of an alarm as it was filled in; not filled in yet if ``place`` is empty. ``change``: the key
    of the alarm to change; ``version``: the one of its versions that the form shows."""

    name: WrittenField = ""
    place: WrittenField = ""
    value: WrittenField = "actual"
    above: WrittenField = ""
    below: WrittenField = ""
    deadband: WrittenField = ""
    change_per_s: WrittenField = ""
    state: WrittenField = ""
    on_delay_s: WrittenField = ""
    off_delay_s: WrittenField = ""
    priority: WrittenField = "medium"
    cause: WrittenText = ""
    consequence: WrittenText = ""
    response: WrittenText = ""
    days: WrittenField = "7"
    change: Annotated[str, Field(max_length=200)] = ""
    version: WrittenField = ""


@router.get("/alarms/own")
async def own_alarms_page(
    request: Request,
    person: Engineer,
    simulator: SimulatorOf,
    history: HistoryOf,
    query: Annotated[WrittenAlarm, Query()],
) -> Response:
    """Show the alarms of the site, the form, and what the alarm of the form would have done."""
    written = _written(query)
    if not written["place"]:
        return _page(request, written)
    try:
        unnamed = templates_of(request).language_of(request).t(UNNAMED)
        settings = proposed({**_keys(written), **_name(written, unnamed)}, list(history.buses.values()))
    except Problem as problem:
        return _page(request, written, fault=problem)
    end, bus = unix_now(), history.buses[settings.bus]
    start = end - int(written["days"]) * DAY_S
    found = await simulator.run(bus, settings, start, end, person.account)
    return _page(request, written, found=found)


@router.get("/alarms/own/values")
async def values_of_unit(request: Request, _: Engineer, query: Annotated[WrittenAlarm, Query()]) -> Response:
    """Show the choice of values, by the labels of the chosen unit."""
    written = _written(query)
    return render(
        request, "alarms/_own_values.html", written=written, values=_values(request, written["place"])
    )


@router.post("/alarms/own")
async def store_own_alarm(
    request: Request,
    person: Annotated[Person, ADD_OWN.permitted],
    own: OwnBook,
    form: Annotated[WrittenAlarm, Form()],
) -> Response:
    """Add the alarm of the form, or change the one that it names."""
    written = _written(form)
    keys = _keys(written) | _name(written, "")
    try:
        if written["change"]:
            version = parse_integer(written["version"]) or 0
            kept = _kept(own, written["change"])
            done = await own.change(person, written["change"], version, kept | keys)
        else:
            done = await own.add(person, keys)
    except Problem as problem:
        return _page(request, written, fault=problem)
    return RedirectResponse("/alarms/own?" + urlencode({"done": done.key}), SEE_OTHER)


@router.post("/alarms/own/remove")
async def remove_own_alarm(
    person: Annotated[Person, REMOVE_OWN.permitted],
    own: OwnBook,
    alarm: Annotated[str, Form(max_length=200)],
    version: Annotated[int, Form(ge=1, le=2**62)],
    reason: TypedReason = "",
) -> Response:
    """Remove an alarm that was added."""
    await own.remove(person, alarm, version, given_reason(reason))
    return RedirectResponse("/alarms/own", SEE_OTHER)


def _page(
    request: Request,
    written: dict[str, str],
    *,
    fault: Problem | None = None,
    found: AlarmSimulation | None = None,
) -> Response:
    own, alarms = service_of(request, OwnAlarmBook), service_of(request, LineAlarms)
    places = [place for place in alarms.places() if "/" in place[0]]
    faults = _by_field(fault, written)
    return render(
        request,
        "alarms/own.html",
        configured=[(each, alarms.place(each.bus, each.unit), added) for each, added in own.every()],
        left_aside=list(own.left_aside.values()),
        done=request.query_params.get("done", ""),
        places=places,
        values=_values(request, written["place"] or (places[0][0] if places else "")),
        values_of={place: _values(request, place) for place in _places_of(own)},
        spans=SPANS,
        written=written,
        faults=faults,
        fault=None if fault is None or faults else fault.message,
        found=found,
        status=200 if fault is None else fault.status,
    )


def _by_field(fault: Problem | None, written: Mapping[str, str]) -> dict[str, Message]:
    """Return what is wrong with which field, as the page names it and as its value was typed; empty if a part
    of the fault is of no field."""
    if fault is None:
        return {}
    found: dict[str, Message] = {}
    for each in cast(list[Message], fault.message.params.get("messages", [fault.message])):
        if (key := str(each.params.get("key"))) in _LABELS:
            found[key] = Message(
                each.code, {**each.params, "key": term(_LABELS[key]), "value": escaped(written[key])}
            )
        elif each.code in _FIELD_OF:
            key, code = _FIELD_OF[each.code]
            found[key] = Message(code)
        else:
            return {}
    return found


def _written(form: WrittenAlarm) -> dict[str, str]:
    written: dict[str, str] = form.model_dump()
    return written | ({} if written["days"] in map(str, SPANS) else {"days": "7"})


def _places_of(own: OwnAlarmBook) -> set[str]:
    return {f"{each.bus}/{each.unit}" for each, _ in own.every()}


def _values(request: Request, place: str) -> dict[str, OwnValueWords]:
    """Return the name and the unit of measure of each value of a unit; without labels for an unknown unit."""
    bus, _, number = place.partition("/")
    configured = service_of(request, History).buses.get(bus)
    units = () if configured is None else configured.unit
    unit = next((each for each in units if str(each.id) == number), None)
    translate = templates_of(request).language_of(request).t
    return {name: _words(unit, name, translate) for name in get_args(OwnValue)}


def _words(unit: UnitSettings | None, name: str, translate: Callable[..., str]) -> OwnValueWords:
    value = VALUES["actual" if name == "deviation" else name]
    words = values.text(value, translate)
    wired = values.label(unit, value) if unit else ""
    return OwnValueWords(
        f"{wired} ({words})" if wired else words, values.measure(unit, value) if unit else ""
    )


def _name(written: Mapping[str, str], otherwise: str) -> dict[str, str]:
    return {"name": written["name"].strip() or otherwise}


def _kept(own: OwnAlarmBook, key: str) -> dict[str, Any]:
    """Return the settings of an alarm for which the form has no field, so that they stay."""
    former = own.added.get(key)
    return {} if former is None else former.settings.model_dump(include=_WITHOUT_FIELD)


def _keys(written: dict[str, str]) -> dict[str, Any]:
    """Return the keys of ``[[alarm]]``; a number may have a decimal comma."""
    bus, _, unit = written["place"].partition("/")
    keys: dict[str, Any] = {
        "bus": bus,
        "unit": parse_integer(unit) or 0,
        "value": written["value"],
        "priority": written["priority"],
    }
    keys |= {key: written[key].replace(",", ".") for key in _NUMBERS if written[key].strip()}
    keys |= {key: written[key].strip() for key in _TEXTS}
    keys |= {key: _delay(written[key].replace(",", ".")) for key in _DELAYS if written[key].strip()}
    return keys | ({"state": written["state"]} if written["state"] else {})


def _delay(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


async def _find(alarms: LineAlarms, search: Search) -> Iterable[FoundPlace]:
    """Find the alarms that are not normal."""
    found: list[FoundPlace] = []
    for alarm in alarms.present():
        definition, t = alarm.definition, search.language.t
        place = alarms.place(definition.bus, definition.unit)
        name, state = t(definition.name), t(alarm.state_text)
        label = f"{place} · {name}" if place else name
        at = alarm.state_at
        shown = state if at is None else f"{state} · {search.formats.since(at, unix_now())}"
        found += matched(search, FoundPlace(label, f"/alarms/{alarm.id}", shown), name, place, state)
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
    _add_banner(services, AlarmBanner(alarms), alarms.tick)
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
        lambda unit: sources.drift[name].is_drifted(unit),
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


def _add_banner(services: Services, banner: AlarmBanner, observe_age: Callable[[], None]) -> None:
    templates = services[Templates]

    def alarms_in(_: Caller | None, language: Language) -> Fields:
        return banner.banner(Translator(language, templates.formats(language.tag)))

    services[Sources].show_alarms(
        banner.banner, banner.unit_fields, banner.delay_s, banner.since, banner.shelved_until, observe_age
    )
    templates.parts["head_alarms"] = alarms_in


def _stream(stream: LineStream, alarms: LineAlarms, alarm: Alarm) -> None:
    stream.add("alarm", alarm.definition.bus, partial(alarm_json, alarms, alarm))


FEATURE = Feature(
    make,
    (router, own_alarms.router, api.router, pages.router),
    acts=ACTS,
)

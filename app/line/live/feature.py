"""The live state as a feature: the present state of every unit, the record of its changes, the hub of
browsers, and the search for units, inputs and outputs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial

from app.core.database.files import Reserve
from app.core.find.finders import Finders, FoundPlace, LiveBit, Search, matched, missing
from app.core.messages import DEFAULT
from app.core.web.formats import UNKNOWN
from app.core.web.services import Registry
from app.core.web.templating import Templates
from app.feature import Feature, Services
from app.line.history.service import History, status_words
from app.line.history.status import store_notice
from app.line.live import hub, pages
from app.line.live.api import routes
from app.line.live.api.routes import LineStream
from app.line.live.api.view import LineView
from app.line.live.bus_live import BusLive, LiveState, UnitLive, bits_of, unit_link_now
from app.line.live.change_recorder import ChangeRecorder, LineEvent, OnsetLookup
from app.line.live.fields import Translator, name_on_site, unit_key
from app.line.live.hub import Hub
from app.line.live.sources import Notice, Sources
from app.people.audit.anchor import Anchoring, anchor_notice
from app.people.audit.log import EventLog
from bus.instants import unix_now
from bus.messages import Message, term

INPUTS = {
    "run": term("Run input"),
    "estop": term("E-stop input"),
    "preset": term("Preset input"),
    "reverse": term("Reverse input"),
    "up": term("Up input"),
    "down": term("Down input"),
    "slave": term("Follower input"),
}
"""The inputs by the names of their labels, in the order of ST1."""


async def find_units(live: LiveState, search: Search) -> Iterable[FoundPlace]:
    """Find units by their name, address, group and wiring."""
    found: list[FoundPlace] = []
    for bus, unit, href in _units(live):
        settings = unit.settings
        parts = (str(settings.id), settings.group, bus.settings.name)
        detail = " · ".join(part for part in parts if part)
        found += matched(search, FoundPlace(settings.name, href, detail, is_name=True), *unit.names)
    return found


async def find_wiring(live: LiveState, search: Search) -> Iterable[FoundPlace]:
    """Find inputs and outputs by their labels and standard names, each with its present state."""
    found: list[FoundPlace] = []
    t, words = search.language.t, search.words
    places: dict[str | int, str] = {name: t(standard) for name, standard in INPUTS.items()}
    places |= {number: f"{t(term('Output'))} {number}" for number in range(1, 7)}
    for bus, unit, href in _units(live):
        name = name_on_site(bus.settings.name, unit.settings.name, live.buses)
        labels: dict[str | int, str] = dict(unit.settings.labels.input.items())
        labels |= unit.settings.labels.output.items()
        for place, standard in places.items():
            names = [each for each in (labels.get(place), standard) if each]
            # A unit that matches by its name alone is found among the units.
            if len(missing(words, names)) < len(words):
                shown = FoundPlace(f"{name} · {names[0]}", href, is_name=True)
                for best in matched(search, shown, *names, unit.settings.name, str(unit.settings.id)):
                    bit = _bit_of(search, href, place)
                    found.append(best._replace(detail=_state(bus, unit, place, bit), bit=bit))
    return found


def _units(live: LiveState) -> Iterator[tuple[BusLive, UnitLive, str]]:
    for bus in live.buses.values():
        for unit in bus.units.values():
            yield bus, unit, f"/units/{unit_key(bus.settings.name, unit.settings.id)}"


def _bit_of(search: Search, href: str, place: str | int) -> LiveBit:
    """Return the live bit of an input (by name) or of an output (by number)."""
    field = f"outputs@{place - 1}" if isinstance(place, int) else f"inputs@{list(INPUTS).index(place)}"
    words = ("input_active", "input_healthy") if place == "estop" else ("input_on", "input_off")
    return LiveBit(href.removeprefix("/units/"), field, *(search.language.t(Message(word)) for word in words))


def _state(bus: BusLive, unit: UnitLive, place: str | int, bit: LiveBit) -> str:
    """Return the word for the state of an input or output now."""
    if unit.reading is None or unit_link_now(bus, unit, unix_now()) != "online":
        return UNKNOWN
    bits = bits_of(bus, unit.reading)
    inputs = dict(zip(INPUTS, bits.inputs.values(), strict=True))
    is_on = bits.outputs[place - 1] if isinstance(place, int) else inputs[place]
    return bit.on if is_on else bit.off


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
    """Make the recorder of the site, or of one bus, and add it to its ``owner``."""
    recorder = owner.add(ChangeRecorder(services[EventLog], bus))
    name = f"changes of {bus or 'the site'}"
    services.lifespan.add(name, recorder.follow, finish=recorder.recorded)
    return recorder


def _sources_of_records(services: Services) -> Sources:
    """Return the sources of notices about the records; later features add theirs."""
    history, anchoring, reserve = services[History], services[Anchoring], services[Reserve]
    notices: list[Notice] = [
        lambda formats, now: store_notice(history.status, formats, now),
        lambda formats, now: anchor_notice(anchoring.status, formats, now),
        lambda _formats, _now: reserve.notice,
    ]
    return Sources(notices=notices, history_fault=lambda: history.status.message)


def _make_screens(services: Services, live: LiveState, sources: Sources) -> None:
    """Make the services that send changes to browsers and programs."""
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

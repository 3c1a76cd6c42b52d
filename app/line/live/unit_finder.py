"""Finds units, and their inputs and outputs with the present state of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from app.core.find.finders import FoundPlace, Search, matched, missing
from app.core.web.formats import UNKNOWN
from app.line.live.bus_live import BusLive, LiveState, UnitLive, bits_of, unit_link_now
from app.line.live.fields import unit_key
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
        name = unit.settings.name
        labels: dict[str | int, str] = dict(unit.settings.labels.input.items())
        labels |= unit.settings.labels.output.items()
        for place, standard in places.items():
            names = [each for each in (labels.get(place), standard) if each]
            # A unit by its name alone is found among the units.
            if len(missing(words, names)) < len(words):
                shown = FoundPlace(f"{name} · {names[0]}", href, is_name=True)
                for best in matched(search, shown, *names, name, str(unit.settings.id)):
                    found.append(best._replace(detail=_state(search, bus, unit, place)))
    return found


def _units(live: LiveState) -> Iterator[tuple[BusLive, UnitLive, str]]:
    for bus in live.buses.values():
        for unit in bus.units.values():
            yield bus, unit, f"/units/{unit_key(bus.settings.name, unit.settings.id)}"


def _state(search: Search, bus: BusLive, unit: UnitLive, place: str | int) -> str:
    """Return the word for the state of an input, by its name, or of an output, by its number."""
    if unit.reading is None or unit_link_now(bus, unit, unix_now()) != "online":
        return UNKNOWN
    bits = bits_of(bus, unit.reading)
    inputs = dict(zip(INPUTS, bits.inputs.values(), strict=True))
    is_on = bits.outputs[place - 1] if isinstance(place, int) else inputs[place]
    words = ("input_active", "input_healthy") if place == "estop" else ("input_on", "input_off")
    return search.language.t(Message(words[not is_on]))

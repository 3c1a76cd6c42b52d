"""A live line for tests of what is shown: one bus, readings put in by hand, time passed in."""

from __future__ import annotations

from app.core.messages import Languages
from app.core.web.formats import Formats
from app.line.live.api.view import LineView
from app.line.live.bus_live import LiveState
from app.line.live.fields import Translator
from app.line.live.screen import Screen
from bus.contract import BusLink, ParameterValue, Reading, UnitLink
from bus.settings import BusSettings, UnitLabels, UnitSettings
from tests.app.played_sources import played_sources

AT_SPEED, REMOTE, RUN, HEALTHY = 0x80, 0x40, 0x01, 0x02
PARAMETERS = {2: 2000, 3: 1, 6: 100, 7: 200, 8: 0, 12: 10, 22: 0, 23: 510}


def translator(tag: str = "en") -> Translator:
    language = Languages()[tag]
    return Translator(language, Formats(language.locale))


def line(units: int = 2) -> LiveState:
    """Online, at 120.0 of 200.0, everything well at the time 100."""
    settings = tuple(
        UnitSettings(id=n, name=f"Unit {n}", labels=UnitLabels(unit="m/min")) for n in range(1, units + 1)
    )
    live = LiveState([BusSettings(name="dry", port="/dev/null", unit=settings)], 0.0)
    live.buses["dry"].worker_lost = None
    live.buses["dry"].apply([BusLink(at=100.0, link="open")])
    for number in range(1, units + 1):
        parameters = [
            ParameterValue(unit=number, number=n, at=100.0, raw=raw) for n, raw in PARAMETERS.items()
        ]
        live.buses["dry"].apply(
            [UnitLink(unit=number, at=100.0, link="online"), *parameters, reading(number)]
        )
    return live


def reading(
    unit: int = 1,
    at: float = 100.0,
    commanded: int = 1200,
    actual: int = 1200,
    outputs: int = AT_SPEED | REMOTE,
    inputs: int = RUN | HEALTHY,
) -> Reading:
    return Reading(
        unit=unit, at=at, commanded=commanded, actual=actual, analog=127, outputs=outputs, inputs=inputs
    )


def line_view(live: LiveState, blocks: dict[int, str] | None = None) -> LineView:
    """The view of the API."""
    return LineView("Mill 7", live, played_sources(live.buses, blocks), translator())


def screen(live: LiveState, tag: str = "en", blocks: dict[int, str] | None = None) -> Screen:
    """Return the screen, updated at the time 100."""
    made = Screen(live, translator(tag), played_sources(live.buses, blocks))
    made.refresh(100.0)
    return made

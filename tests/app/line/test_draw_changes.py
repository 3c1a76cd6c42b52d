"""What a review states about the draw between neighbors before new setpoints are sent."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.messages import Languages
from app.line.commands.rules.draw_changes import draw_changes
from app.line.live.state.bus_live import BusLive
from bus.contract import ParameterValue, UnitLink
from bus.settings import BusSettings
from tests.app.screens import line, reading


def at_120(units: int = 4, **keys: object) -> BusLive:
    """Every unit at 120.0 m/min, one web."""
    bus = line(units).buses["dry"]
    settings = bus.settings.model_dump(exclude_unset=True) | keys
    bus.seams = BusSettings.model_validate(settings).seams
    return bus


def texts(bus: BusLive, setpoints: dict[int, int], tag: str = "en") -> list[tuple[str, bool]]:
    return [(Languages()[tag].t(each.text), each.is_out) for each in draw_changes(bus, setpoints)]


BANDED = {"draw_percent": ["-0.5", "2.0"]}


def test_a_neighbor_that_stays_is_named_with_its_speed_and_the_draw() -> None:
    assert texts(at_120(**BANDED), {2: 1140}) == [
        (
            "Unit 1 stays at 120.0 m/min: draw of Unit 2 \N{MINUS SIGN}5.0 %,"
            " outside its band of \N{MINUS SIGN}0.5 to 2.0 %",
            True,
        ),
        ("Unit 3 stays at 120.0 m/min: draw +5.3 %, outside its band of \N{MINUS SIGN}0.5 to 2.0 %", True),
    ]
    assert texts(at_120(**BANDED), {3: 1300}, "de")[0] == (
        "Unit 2 bleibt bei 120,0 m/min: Verzug von Unit 3 +8,3 %,"
        " außerhalb seines Bandes von \N{MINUS SIGN}0,5 bis 2,0 %",
        True,
    )


def test_within_the_band_there_is_nothing_to_state() -> None:
    assert texts(at_120(**BANDED), {4: 1212}) == []


def test_without_a_band_a_changed_draw_is_stated_quietly() -> None:
    assert texts(at_120(), {4: 1212}) == [("Unit 3 stays at 120.0 m/min: draw of Unit 4 +1.0 %", False)]


def test_two_neighbors_of_a_change_have_a_draw_to_each_other() -> None:
    assert texts(at_120(3, **BANDED), {1: 1200, 2: 1300, 3: 1300}) == [
        ("draw of Unit 2 to Unit 1: +8.3 %, outside its band of \N{MINUS SIGN}0.5 to 2.0 %", True)
    ]


@given(st.integers(1, 83))
def test_a_line_that_changes_as_one_has_nothing_to_state(factor: int) -> None:
    assert texts(at_120(**BANDED), dict.fromkeys(range(1, 5), 1200 * factor)) == []


def test_of_followers_standing_units_and_unknown_speeds_nothing_is_stated() -> None:
    bus = at_120(**BANDED)
    bus.apply([ParameterValue(unit=2, number=8, at=100.0, raw=1), reading(4, 100.0, 0, 0)])
    assert texts(bus, {3: 1300}) == []
    bus.units[2].parameters.pop(8)
    bus.units[2].reading = None
    assert texts(bus, {3: 1300}) == []


def test_an_offline_neighbor_keeps_its_speed() -> None:
    bus = at_120(**BANDED)
    bus.apply([UnitLink(unit=4, at=100.0, link="offline")])
    assert len(texts(bus, {3: 1300})) == 2


@pytest.mark.parametrize("setpoints", [{}, {2: 1200}, {2: 0}])
def test_what_changes_no_draw_is_not_stated(setpoints: dict[int, int]) -> None:
    assert texts(at_120(**BANDED), setpoints) == []

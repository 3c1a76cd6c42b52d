"""Draw between neighboring sections: the rule, and where it is read: pages, API, cause, configuration."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from app.core.web.formats import UNKNOWN
from app.line.conditions.condition import (
    MAX_TENTHS,
    NO_DRAW,
    UNKNOWN_DRAW,
    Draw,
    SectionSpeed,
    draw_between,
    percent_of,
)
from app.line.live.bus_live import BusLive, LiveState, draw_of
from bus.contract import UnitLink
from bus.settings import BusSettings, UnitLabels, UnitSettings
from tests.app.screens import line, line_view, reading, screen

BAND = (Decimal("-0.5"), Decimal("2.0"))
raws = st.integers(1, 99_999)
speeds = st.builds(SectionSpeed, raws, st.integers(0, 4), st.just("m/min"))
bands = st.lists(st.decimals(-100, 1000, places=1), min_size=2, max_size=2, unique=True).map(
    lambda pair: tuple(sorted(pair))
)


def value_of(speed: SectionSpeed) -> Fraction:
    return Fraction(speed.raw or 0, 10 ** (speed.decimals or 0))


@given(speeds, speeds)
def test_the_draw_is_the_ratio_of_the_displayed_speeds(before: SectionSpeed, section: SectionSpeed) -> None:
    exact = 1000 * (value_of(section) / value_of(before) - 1)
    tenths = draw_between(before, section, ()).tenths
    assert tenths is not None
    assert abs(tenths - exact) <= Fraction(1, 2) or tenths == MAX_TENTHS < exact


@given(speeds, speeds, bands)
def test_the_judged_draw_is_the_shown_one(
    before: SectionSpeed, section: SectionSpeed, band: tuple[Decimal, ...]
) -> None:
    draw = draw_between(before, section, band)
    assert draw.tenths is not None
    assert (draw.state == "in_band") == (band[0] <= percent_of(draw.tenths) <= band[1])
    assert draw_between(before, section, band, judged=False) == Draw("ramping", draw.tenths)
    assert draw_between(before, section, ()) == Draw("none", draw.tenths)


@given(speeds, speeds, bands)
def test_without_both_speeds_in_one_quantity_nothing_is_known(
    before: SectionSpeed, section: SectionSpeed, band: tuple[Decimal, ...]
) -> None:
    for unknown in (section._replace(raw=None), section._replace(decimals=None)):
        assert draw_between(before, unknown, band) == draw_between(unknown, before, band) == UNKNOWN_DRAW
    for other in (section._replace(raw=0), section._replace(quantity="rpm"), section._replace(quantity=None)):
        assert draw_between(before, other, band) == draw_between(other, before, band) == NO_DRAW
    ratios = before._replace(quantity=None), section._replace(quantity=None)
    assert draw_between(*ratios, band) == NO_DRAW


def banded(*bands: tuple[str, ...] | None, default: tuple[str, ...] = ("-0.5", "2.0")) -> LiveState:
    """As many units as bands, at 120.0."""
    live = line(len(bands))
    bus = live.buses["dry"]
    units = tuple(
        UnitSettings(id=n, name=f"Unit {n}", labels=UnitLabels(unit="m/min"), draw_percent=band)
        for n, band in enumerate(bands, 1)
    )
    bus.seams = BusSettings(name="dry", port="/dev/null", unit=units, draw_percent=default).seams
    return live


def shown(live: LiveState, unit: int, tag: str = "en", now: float = 100.0) -> tuple[str, str]:
    page = screen(live, tag)
    page.refresh(now)
    return page.flat()[f"dry/{unit}.draw"], page.flat()[f"dry/{unit}.draw_state"]


def drawn(*actual: int, at: float = 100.0) -> LiveState:
    """A line whose units are at speed."""
    live = banded(*[None] * len(actual))
    live.buses["dry"].apply([reading(n, at, raw, raw) for n, raw in enumerate(actual, 1)])
    return live


def test_a_page_and_the_api_show_each_draw_but_that_of_the_first_unit() -> None:
    live = drawn(1142, 1202, 1202)
    assert [shown(live, n) for n in (1, 2, 3)] == [
        ("", "none"),
        ("+5.3 %", "out_of_band"),
        ("±0.0 %", "in_band"),
    ]
    assert shown(live, 2, "de")[0] == "+5,3 %"
    units = line_view(live).bus("dry", 100.0)["units"]
    assert [(unit["draw"], unit["draw_state"]) for unit in units] == [
        (None, "none"),
        ("5.3", "out_of_band"),
        ("0.0", "in_band"),
    ]


def test_a_slower_section_has_a_negative_draw() -> None:
    live = drawn(1200, 1196)
    assert shown(live, 2) == ("−0.3 %", "in_band")  # noqa: RUF001
    assert line_view(live).unit("dry", 2, 100.0)["draw"] == "-0.3"


def test_without_a_reading_of_the_present_of_both_the_draw_is_unknown() -> None:
    live = drawn(1142, 1202)
    bus = live.buses["dry"]
    assert shown(live, 2, now=104.0) == (UNKNOWN, "unknown")
    bus.apply([UnitLink(unit=1, at=100.0, link="offline")])
    assert shown(live, 2) == (UNKNOWN, "unknown")
    assert line_view(live).unit("dry", 2, 100.0)["draw"] is None
    bus.units[1].reading = None
    assert draw_of(bus, bus.units[2], 100.0).state == "unknown"


def test_a_standing_line_and_different_displays_have_no_draw() -> None:
    standing = drawn(1200, 1200)
    standing.buses["dry"].apply([reading(n, 100.0, 0, 0) for n in (1, 2)])
    assert shown(standing, 2) == ("", "none")
    other = drawn(1142, 1202)
    labels = UnitSettings(id=1, name="Unit 1", labels=UnitLabels(unit="rpm"))
    other.buses["dry"].units[1].settings = labels
    assert shown(other, 2) == ("", "none")


def test_a_draw_is_shown_and_not_judged_without_a_band_and_while_a_section_ramps() -> None:
    free = banded(None, ())
    free.buses["dry"].apply([reading(1, 100.0, 1142, 1142)])
    assert shown(free, 2) == ("+5.1 %", "unjudged")
    ramping = drawn(1142, 1202)
    ramping.buses["dry"].apply([reading(1, 100.1, 1300, 1143, outputs=0x40)])
    assert shown(ramping, 2) == ("+5.2 %", "unjudged")
    ramping.buses["dry"].apply([reading(1, 100.2, 1300, 1140, inputs=0)])
    assert shown(ramping, 2) == ("", "none"), "a section that coasts has none"


def run_out_of_band(seconds: float) -> BusLive:
    live = drawn(1200, 1200)
    bus = live.buses["dry"]
    for step in range(int(seconds * 5) + 1):
        at = 101.0 + step / 5
        bus.apply([reading(1, at, 1142, 1142), reading(2, at)])
    return bus


@pytest.mark.parametrize(("seconds", "level"), [(4.0, ""), (6.0, "high")])
def test_the_verdict_names_a_draw_once_it_lasts(seconds: float, level: str) -> None:
    bus = run_out_of_band(seconds)
    live = LiveState([bus.settings], 0.0)
    live.buses["dry"] = bus
    page = screen(live)
    page.refresh(101.0 + seconds)
    assert page.flat()["line_summary.level"] == level
    assert ("Draw out of band since" in page.flat()["line_summary.verdict"]) == bool(level)
    bus.apply([reading(2, 101.0 + seconds, 1300, 1143, outputs=0x40)])
    page.refresh(101.0 + seconds)
    assert page.flat()["line_summary.level"] == level, "as its alarm stays, while a section ramps"


def test_a_draw_out_of_band_keeps_its_cause_and_time_over_a_gap_without_responses() -> None:
    """Its alarm has not cleared: nobody saw that."""
    bus = run_out_of_band(6.0)
    live = LiveState([bus.settings], 0.0)
    live.buses["dry"] = bus
    page = screen(live)
    page.refresh(107.0)
    before = page.flat()["line_summary.verdict"]
    assert "Draw out of band since" in before

    def shown(at: float) -> str:
        page.refresh(at)
        return str(page.flat()["line_summary.verdict"])

    bus.apply([reading(2, 111.0)])
    assert (bus.units[2].draw.state, shown(111.0)) == ("unknown", before)
    bus.apply([reading(1, 111.2, 1142, 1142), reading(2, 111.4)])
    assert shown(111.4) == before
    bus.apply([reading(1, 111.6), reading(2, 111.8)])
    assert "Draw" not in shown(111.8)


UNITS = tuple({"id": n, "name": f"Unit {n}"} for n in (1, 2, 3))


def bus_of(*units: object, **keys: object) -> BusSettings:
    return BusSettings.model_validate({"name": "dry", "port": "/dev/null", "unit": units, **keys})


def test_a_unit_may_set_another_band_than_its_bus_or_none() -> None:
    first, second, third = UNITS
    bus = bus_of(first, second | {"draw_percent": ["-0.1", 1.5]}, third, draw_percent=[-0.5, 2])
    assert {n: (seam.before, seam.band) for n, seam in bus.seams.items()} == {
        2: (1, (Decimal("-0.1"), Decimal("1.5"))),
        3: (2, BAND),
    }
    assert bus_of(first, second | {"draw_percent": []}, draw_percent=[-0.5, 2]).seams[2].band == ()
    assert bus_of(*UNITS).seams[3].band == ()


@pytest.mark.parametrize("band", [[1], [2, 1], [1, 1], [1, 2, 3], [0, "x"], [0, 0.25], [-101, 0], 5, True])
def test_a_band_is_two_numbers_in_order(band: object) -> None:
    with pytest.raises(ValidationError, match="lowest and the highest draw"):
        bus_of(*UNITS, draw_percent=band)


def test_the_first_unit_has_no_band() -> None:
    first, *rest = UNITS
    with pytest.raises(ValidationError):
        bus_of(first | {"draw_percent": [0, 1]}, *rest)

"""Whether a quality is still trusted: by the worker's report and by its age, whichever is worse."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.live.bus_live import (
    BusLive,
    LiveState,
    offline_after_s,
    scan_s_at_best,
    scan_s_of,
    stale_after_s,
    unit_link_now,
)
from bus.contract import BusFigures, BusLink, UnitLink, UnitLinkState
from tests.app.stage import bus_settings, reading

READ_AT = 1000.0


def bus_of(reported: UnitLinkState = "online", *, port: str = "open", scan_s: float | None = None) -> BusLive:
    """Unit 1 was read at READ_AT."""
    live = LiveState([bus_settings()], 0.0)
    read = reading(1)
    word = type(read)(1, READ_AT, read.commanded, read.actual, read.analog, read.outputs, read.inputs)
    live.buses["dry-end"].apply([word, UnitLink(unit=1, at=READ_AT, link=reported)])
    live.buses["dry-end"].apply([BusLink(at=0.0, link="open" if port == "open" else "closed")])
    if scan_s is not None:
        live.buses["dry-end"].apply([BusFigures(0.0, 1 / scan_s, scan_s, 0.9, scan_s)])
    return live.buses["dry-end"]


@pytest.mark.parametrize(
    ("reported", "port", "age_s", "link"),
    [
        ("online", "open", 0.0, "online"),
        ("online", "open", 2.0, "online"),
        ("online", "open", 2.01, "stale"),
        ("online", "open", 10.1, "offline"),
        ("stale", "open", 0.0, "stale"),
        ("offline", "open", 0.0, "offline"),
        ("online", "closed", 0.0, "stale"),
        ("online", "closed", 11.0, "offline"),
    ],
)
def test_the_worse_of_word_port_and_age(
    reported: UnitLinkState, port: str, age_s: float, link: UnitLinkState
) -> None:
    bus = bus_of(reported, port=port)
    assert unit_link_now(bus, bus.units[1], READ_AT + age_s) == link


def test_a_long_scan_is_given_its_time() -> None:
    bus = bus_of(scan_s=6.6)
    assert unit_link_now(bus, bus.units[1], READ_AT + 13.1) == "online"
    assert unit_link_now(bus, bus.units[1], READ_AT + 13.3) == "stale"
    assert unit_link_now(bus, bus.units[1], READ_AT + 34.0) == "offline"


def test_a_unit_that_never_responded_is_unknown_whatever_is_reported() -> None:
    bus = bus_of()
    assert unit_link_now(bus, bus.units[2], READ_AT) == "unknown"


def test_before_figures_the_scan_is_what_the_wire_allows() -> None:
    bus = bus_of()
    assert scan_s_of(bus) == scan_s_at_best(bus.settings)
    assert scan_s_at_best(bus.settings) == pytest.approx(3 * 250 / 9600)


@given(st.floats(0, 1000))
def test_offline_comes_after_stale(scan_s: float) -> None:
    assert offline_after_s(scan_s) > stale_after_s(scan_s) >= 2.0

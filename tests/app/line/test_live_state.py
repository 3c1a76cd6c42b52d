"""The present state: changed only by reports of workers, and trusted no longer than its age allows."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.live.bus_live import (
    NO_WORKER,
    Audience,
    BusLive,
    LiveState,
    offline_after_s,
    scan_s_at_best,
    scan_s_of,
    stale_after_s,
    unit_link_now,
    updates_of,
)
from bus.contract import BusFigures, BusLink, ParameterValue, Staged, UnitLink, UnitLinkState, Update
from tests.app.fake_worker import bus_settings, reading, snapshot

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


def test_before_figures_a_limited_scan_is_given_its_time() -> None:
    bus = bus_of()
    bus.settings = bus.settings.model_copy(update={"max_scan_hz": 0.2})
    assert scan_s_of(bus) == 5.0
    bus.settings = bus.settings.model_copy(update={"max_scan_hz": 100.0})
    assert scan_s_of(bus) == pytest.approx(3 * 250 / 9600), "more than the wire carries"


@given(st.floats(0, 1000))
def test_offline_comes_after_stale(scan_s: float) -> None:
    assert offline_after_s(scan_s) > stale_after_s(scan_s) >= 2.0


@pytest.fixture
def live() -> LiveState:
    return LiveState([bus_settings()], 100.0)


def test_at_first_nothing_is_known(live: LiveState) -> None:
    bus = live.buses["dry-end"]
    assert (bus.link.link, bus.link.cause, bus.worker_connected) == ("closed", NO_WORKER, False)
    assert list(bus.units) == [1, 2, 16]
    assert {unit.link.link for unit in bus.units.values()} == {"unknown"}
    assert all(unit.reading is None for unit in bus.units.values())


def test_each_word_changes_what_it_is_about(live: LiveState) -> None:
    figures = BusFigures(at=1.0, scan_hz=4.0, scan_s=0.25, wire_utilisation=0.9, scan_s_with_one_more=0.3)
    link = UnitLink(unit=2, at=1.0, link="online")
    port = BusLink(at=1.0, link="open")
    update = reading(2, 55)
    live.buses["dry-end"].apply(
        [port, figures, link, update, ParameterValue(2, 3, 1.0, 1), Staged(2, 1.0, 77)]
    )
    bus, unit = live.buses["dry-end"], live.buses["dry-end"].units[2]
    assert (bus.link, bus.figures) == (port, figures)
    assert (unit.link, unit.reading, unit.staged, unit.parameter_raw(3)) == (link, update, 77, 1)
    assert unit.parameter_raw(4) is None
    live.buses["dry-end"].apply([Staged(2, 2.0, None)])
    assert unit.staged is None
    assert live.buses["dry-end"].units[1].reading is None


def test_the_rate_is_the_last_that_the_worker_reported(live: LiveState) -> None:
    bus = live.buses["dry-end"]
    live.buses["dry-end"].apply([BusLink(at=1.0, link="open")])
    assert bus.baud == 9600, "as configured where an older worker reports none"
    live.buses["dry-end"].apply([BusLink(at=1.0, link="open", baud=4800)])
    assert bus.baud == 4800


def test_a_unit_that_is_not_configured_is_passed_over(live: LiveState) -> None:
    live.buses["dry-end"].apply([reading(99), reading(1, 5)])
    found = live.buses["dry-end"].units[1].reading
    assert found is not None
    assert found.commanded == 5


def test_a_snapshot_is_the_same_as_its_updates(live: LiveState) -> None:
    present = snapshot()
    other = LiveState([bus_settings()], 100.0)
    live.buses["dry-end"].connect_worker(present)
    other.buses["dry-end"].apply(updates_of(present))
    assert live.buses["dry-end"].units == other.buses["dry-end"].units


def test_a_lost_worker_leaves_the_readings_and_takes_the_trust(live: LiveState) -> None:
    live.buses["dry-end"].connect_worker(snapshot())
    live.buses["dry-end"].apply([UnitLink(unit=16, at=1.0, link="offline")])
    live.buses["dry-end"].lose_worker(9.0)
    bus = live.buses["dry-end"]
    assert (bus.link, bus.figures) == (BusLink(at=9.0, link="closed", cause=NO_WORKER), None)
    assert bus.units[1].reading is not None
    assert [unit.link.link for unit in bus.units.values()] == ["stale", "stale", "offline"]


def test_subscribers_get_every_change_until_they_leave(live: LiveState) -> None:
    received: list[Sequence[Update]] = []
    leave = live.buses["dry-end"].subscribe(Audience.STREAM, received.append)
    update = [reading(1)]
    live.buses["dry-end"].apply(update)
    leave()
    live.buses["dry-end"].apply([reading(1)])
    assert received == [update]


def test_subscribers_learn_of_a_report_in_the_order_of_their_audiences(live: LiveState) -> None:
    learned: list[Audience] = []
    for audience in reversed(Audience):
        live.buses["dry-end"].subscribe(audience, lambda _, audience=audience: learned.append(audience))
    live.buses["dry-end"].apply([reading(1)])
    assert learned == list(Audience)


def test_a_subscriber_that_fails_stops_no_other(live: LiveState) -> None:
    def fail(updates: Sequence[Update]) -> None:
        raise RuntimeError(updates)

    received: list[Sequence[Update]] = []
    live.buses["dry-end"].subscribe(Audience.BROWSERS, fail)
    live.buses["dry-end"].subscribe(Audience.STREAM, received.append)
    update = [reading(1, 5)]
    live.buses["dry-end"].apply(update)
    assert received == [update]

"""The present state: changed by reports of workers and by nothing else."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from app.line.live.bus_live import NO_WORKER, Audience, LiveState, updates_of
from bus.contract import BusFigures, BusLink, ParameterValue, Staged, UnitLink, Update
from tests.app.stage import bus_settings, reading, snapshot


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

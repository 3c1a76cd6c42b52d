"""Abnormal conditions of a unit besides the run conditions, and conditions reported once for a bus."""

from __future__ import annotations

import pytest

from app.line.conditions.unit import suspicion
from app.line.live.diagnosis import (
    Cause,
    UnitView,
    all_offline,
    bus_cause,
    shown_cause,
    state_counts,
    unit_cause,
)
from app.line.live.unit_status import Onset
from bus.contract import BusFigures, BusLink, ParameterValue, UnitLink
from bus.messages import Message, term
from tests.app.screens import AT_SPEED, HEALTHY, RUN, line, line_view, reading

NOW = 100.0


def shown(
    blocked: str = "", drifted: str = "", link: str = "online", **changes: int
) -> tuple[str, str] | None:
    """Level and code of what the first line of a unit names."""
    live = line()
    live.buses["dry"].apply([UnitLink(unit=1, at=NOW, link=link), reading(**changes)])  # type: ignore[arg-type]
    bus = live.buses["dry"]
    found = shown_cause(
        bus,
        bus.units[1],
        unit_cause(bus, bus.units[1], NOW),
        NOW,
        blocked=Message.of("block_by", reason=blocked, who="anna") if blocked else None,
        drifted=drifted,
    )
    return (found.level, found.code) if found else None


def test_a_unit_at_speed_in_remote_is_nothing() -> None:
    assert shown() is None


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({"blocked": "belt off"}, ("low", "blocked")),
        ({"drifted": "2 values"}, ("low", "drift")),
        ({"blocked": "belt off", "drifted": "2 values"}, ("low", "blocked")),
        ({"blocked": "belt off", "inputs": RUN}, ("urgent", "estop_active")),
        ({"blocked": "belt off", "outputs": AT_SPEED}, ("low", "not_in_remote")),
        ({"blocked": "belt off", "link": "offline"}, ("high", "unit_offline")),
        ({"drifted": "2 values", "commanded": 0, "actual": 300, "inputs": HEALTHY}, ("low", "drift")),
        ({"drifted": "2 values", "outputs": 0x40, "actual": 900}, ("low", "drift")),
    ],
)
def test_a_broken_rung_comes_before_what_else_is_abnormal(
    given: dict[str, str], found: tuple[str, str]
) -> None:
    assert shown(**given) == found  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("update", "found"),
    [
        (ParameterValue(1, 17, NOW, 1), None),
        (ParameterValue(1, 17, NOW, None, available=False), None),
        (ParameterValue(1, 17, NOW, 3), None),
        (BusFigures(NOW, 1.0, 1.0, 1.0, 1.0, responds_for_all=1), None),
        (
            BusFigures(NOW, 1.0, 1.0, 1.0, 1.0, responds_for_all=2),
            "unit 2 may respond in its place (each response comes twice)",
        ),
    ],
)
def test_a_unit_for_which_another_may_respond_is_abnormal(
    update: ParameterValue | BusFigures, found: str | None
) -> None:
    live = line()
    bus = live.buses["dry"]
    live.buses["dry"].apply([reading(), update])
    cause = shown_cause(bus, bus.units[1], unit_cause(bus, bus.units[1], NOW), NOW, blocked=None, drifted="")
    assert (cause and (cause.level, str(cause.params["why"]))) == (found and ("high", found))
    shown = line_view(live).unit("dry", 1, NOW)["suspect"]
    assert (shown and shown["detail"]) == found


def test_an_address_of_another_speaks_where_most_units_read_their_own() -> None:
    live = line(4)
    bus = live.buses["dry"]
    live.buses["dry"].apply([reading(), ParameterValue(1, 17, NOW, 3), ParameterValue(2, 17, NOW, 3)])
    assert suspicion(bus, bus.units[1]) is None
    live.buses["dry"].apply([ParameterValue(3, 17, NOW, 3)])
    assert suspicion(bus, bus.units[1]) is None, "other units have another #17"
    live.buses["dry"].apply([ParameterValue(2, 17, NOW, 2)])
    assert str(suspicion(bus, bus.units[1])) == "unit 3 may respond in its place"
    assert suspicion(bus, bus.units[2]) is None


def test_a_bus_names_worker_or_port_and_since_when() -> None:
    live = line()
    bus = live.buses["dry"]
    assert bus_cause(bus, 100.5) is None
    live.buses["dry"].apply([BusLink(at=101.0, link="closed", cause=term("no such device"))])
    live.buses["dry"].apply([BusLink(at=105.0, link="closed", cause=term("permission denied"))])
    denied = {"why": term("permission denied")}
    assert bus_cause(bus, 110.0) == Cause("port_lost", "urgent", Onset(101.0), denied)
    live.buses["dry"].lose_worker(120.0)
    assert bus_cause(bus, 130.0) == Cause("worker_lost", "urgent", Onset(120.0))


def test_a_worker_that_stands_still_is_named_before_its_units() -> None:
    live = line()
    bus = live.buses["dry"]
    figures = BusFigures(at=NOW, scan_hz=4.8, scan_s=0.2, wire_utilisation=0.9, scan_s_with_one_more=0.3)
    live.buses["dry"].apply([figures])
    assert bus_cause(bus, 101.9) is None
    assert bus_cause(bus, 102.1) == Cause("worker_silent", "urgent", Onset(NOW))
    live.buses["dry"].apply([reading(at=102.0)])
    assert bus_cause(bus, 102.1) is None, "a unit responded through it"


def test_a_bus_on_which_no_unit_responds_is_one_cause() -> None:
    bus = line(units=3).buses["dry"]
    bus.apply([reading(1, at=NOW - 50), UnitLink(unit=1, at=NOW, link="offline")])
    assert all_offline(bus, NOW) is None
    bus.apply([UnitLink(unit=2, at=NOW, link="offline")])
    assert all_offline(bus, NOW) is None, "the third may be well"
    bus.units[3].reading = None
    assert all_offline(bus, NOW) == Cause("no_unit_responds", "urgent", Onset(NOW))
    bus.apply([UnitLink(unit=3, at=NOW, link="offline")])
    assert all_offline(bus, NOW) == Cause("no_unit_responds", "urgent", Onset(NOW))


def test_units_that_have_their_time_to_respond_first_are_one_cause() -> None:
    bus = line(units=2).buses["dry"]
    for unit in bus.units.values():
        unit.reading = None
    assert all_offline(bus, NOW + 1) == Cause("no_unit_yet", "low")
    late = all_offline(bus, NOW + 100)
    assert late == Cause("no_unit_responds", "urgent", Onset(NOW, exact=False))


def test_the_only_unit_of_a_bus_is_named_itself() -> None:
    bus = line(units=1).buses["dry"]
    bus.apply([UnitLink(unit=1, at=NOW, link="offline")])
    assert all_offline(bus, NOW) is None


def test_only_units_that_respond_are_in_a_state() -> None:
    bus = line().buses["dry"]
    counts = state_counts(UnitView(bus.units[1], link, None) for link in ("online", "stale"))  # type: ignore[arg-type]
    assert (counts["online"], counts["at_speed"]) == (1, 1)

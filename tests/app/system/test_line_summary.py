"""The summary of a line: its verdict, its counts and its speeds."""

from __future__ import annotations

from app.line.live.bus_live import BusLive
from app.system.peers.summary import MAX_POINTS, POINT_S, LineSummary, SpeedTrace, summary_of, view_of
from bus.contract import BusFigures, UnitLink
from bus.messages import Message
from tests.app.screens import HEALTHY, line, reading


def summarized(bus: BusLive, now: float, blocked: Message | None = None, drifted: str = "") -> LineSummary:
    views = [view_of(bus, number, blocked, drifted, now) for number in bus.units]
    return summary_of(bus, views, (), [], "Mill 7", now)


def test_a_line_at_speed() -> None:
    bus = line().buses["dry"]
    bus.apply([BusFigures(at=100.0, scan_hz=4.5, scan_s=0.2, scan_s_with_one_more=0.3, wire_utilisation=0.9)])
    found = summarized(bus, 100.5)
    assert (found.bus, found.site) == ("dry", "Mill 7")
    assert (found.level, found.cause) == ("", None)
    assert str(found.verdict) == "All 2 units at speed"
    assert (found.units, found.states) == (2, {"online": 2, "at_speed": 2})
    assert found.scan_hz == 4.5


def test_the_worst_unit_is_named() -> None:
    bus = line().buses["dry"]
    bus.apply([reading(2, inputs=HEALTHY - 2), UnitLink(unit=1, at=100.0, link="online")])
    found = summarized(bus, 100.5)
    assert (found.level, found.place) == ("urgent", "Unit 2")
    assert found.cause is not None
    assert found.cause.code == "estop_active"
    assert found.cause.cause("urgent").params["motion"] == "stopping"


def test_units_with_one_cause_since_one_minute_are_counted() -> None:
    bus = line().buses["dry"]
    bus.apply([reading(unit, at=100.0, inputs=HEALTHY) for unit in (1, 2)])
    found = summarized(bus, 100.5)
    assert (found.cause and found.cause.code, found.alike) == ("run_off", 2)


def test_a_cause_of_the_bus_comes_before_its_units() -> None:
    bus = line().buses["dry"]
    bus.lose_worker(101.0)
    found = summarized(bus, 110.0)
    assert (found.place, found.cause and found.cause.code) == ("dry", "worker_lost")
    assert found.scan_hz is None


def test_a_condition_of_low_priority_is_no_verdict() -> None:
    bus = line().buses["dry"]
    well = summarized(bus, 100.5)
    blocked = summarized(bus, 100.5, blocked=Message.of("block_by", reason="knife change", who="anna"))
    drifted = summarized(bus, 100.5, drifted="#3 differs")
    for found in (blocked, drifted):
        assert (found.cause, found.level, found.verdict) == (None, "", well.verdict)


def test_a_speed_has_no_point_while_its_decimals_are_not_known() -> None:
    bus, trace = line().buses["dry"], SpeedTrace()
    bus.apply([reading(1, at=100.0)])
    del bus.units[1].parameters[3]
    trace.note(bus, 100.0)
    assert list(trace.points) == [None]


def test_the_speed_has_a_point_each_ten_seconds_and_gaps() -> None:
    bus, trace = line().buses["dry"], SpeedTrace()
    for second in range(25):
        bus.apply([reading(1, at=100.0 + second)])
        trace.note(bus, 100.0 + second)
    assert list(trace.points) == [120.0, 120.0, 120.0]
    bus.apply([reading(1, at=125.0, actual=1180)])
    trace.note(bus, 125.0)
    assert list(trace.points) == [120.0, 120.0, 118.0], "the newest is of the present"
    trace.note(bus, 130.0)
    assert list(trace.points)[-1] is None, "the reading is old"
    trace.note(bus, 130.0 + 5 * POINT_S)
    assert list(trace.points)[4:] == [None] * 5
    trace.note(bus, 1e9)
    assert len(trace.points) == MAX_POINTS

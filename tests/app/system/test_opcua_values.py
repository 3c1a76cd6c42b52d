"""Values, qualities and engineering units as OPC UA clients are given them."""

from __future__ import annotations

from typing import Any

import pytest

from app.line.live.bus_live import BusLive, LiveState, offline_after_s, scan_s_of, stale_after_s
from app.system.opcua.link import Changes, Frames, frame, state_of, to_process
from app.system.opcua.space import OTHER_UNIT, Point, unit_id, unit_points
from app.system.tags import scale_now, tags_of
from bus.contract import BusFigures, BusLink, Staged, UnitFigures, UnitLink
from bus.instants import UnixTime
from tests.app.opcua import line, responds, scales
from tests.for_each import for_each

BEGIN = UnixTime(1_700_000_000.0)


def bus_live() -> BusLive:
    bus = LiveState([line()], BEGIN).buses["dry-end"]
    bus.apply([BusLink(BEGIN, "open")])
    return bus


def points(bus: BusLive, now: UnixTime, unit: int = 1, alarms: int = 0) -> dict[str, Point]:
    live = bus.units[unit]
    scale = scale_now(bus, live)
    found = unit_points(bus, live, scale, alarms, now)
    return {tag.name: point for tag, point in zip(tags_of(live, scale), found, strict=True)}


def test_a_value_is_good_with_the_time_of_its_reading() -> None:
    bus = bus_live()
    bus.apply([*scales(1, BEGIN), *responds(1, BEGIN + 1)])
    found = points(bus, BEGIN + 1.5, alarms=2)
    assert found["Speed/Actual"] == (123.4, "Good", BEGIN + 1)
    assert found["Inputs/Run"] == (True, "Good", BEGIN + 1)
    assert found["Link/State"][:2] == ("online", "Good")
    assert found["Alarms/Active"][:2] == (2, "Good")
    assert found["Parameters/03"] == (1, "Good", BEGIN)


def test_before_the_first_reading_a_value_waits() -> None:
    found = points(bus_live(), BEGIN + 1)
    assert {found[name][:2] for name in ("Speed/Actual", "Outputs/Brake", "Parameters/03")} == {
        (None, "BadWaitingForInitialData")
    }
    assert found["Link/State"].value == "unknown"


def test_a_speed_waits_for_its_decimals() -> None:
    bus = bus_live()
    bus.apply(responds(1, BEGIN))
    found = points(bus, BEGIN)
    assert found["Speed/Actual"][:2] == (None, "BadWaitingForInitialData")
    assert found["Inputs/Run"].quality == "Good"


def test_an_old_value_is_uncertain_and_then_gone() -> None:
    bus = bus_live()
    bus.apply([*scales(1, BEGIN), *responds(1, BEGIN)])
    scan_s = scan_s_of(bus)
    old = points(bus, BEGIN + stale_after_s(scan_s) + 0.1)
    assert old["Speed/Actual"] == (123.4, "UncertainLastUsableValue", BEGIN)
    assert old["Parameters/03"].quality == "UncertainLastUsableValue"
    gone = points(bus, BEGIN + offline_after_s(scan_s) + 0.1)
    assert gone["Speed/Actual"] == (None, "BadNoCommunication", BEGIN)
    assert gone["Parameters/03"].quality == "BadNoCommunication"
    assert gone["Link/State"][:2] == ("offline", "Good")


def test_a_parameter_is_uncertain_until_it_is_read_after_the_unit_was_away() -> None:
    bus = bus_live()
    bus.apply([*scales(1, BEGIN), *responds(1, BEGIN)])
    bus.apply([UnitLink(1, BEGIN + 20, "offline"), *responds(1, BEGIN + 30)])
    assert points(bus, BEGIN + 30)["Parameters/03"][:2] == (1, "UncertainLastUsableValue")
    bus.apply(scales(1, BEGIN + 31))
    assert points(bus, BEGIN + 31)["Parameters/03"][:2] == (1, "Good")


@for_each(("unit", "number"), [("m/min", 12888), ("rpm", 5394509), ("%", 20529), ("pieces", OTHER_UNIT)])
def test_an_engineering_unit_has_its_common_code(unit: str, number: int) -> None:
    assert unit_id(unit) == number


def through_the_pipe(message: Any) -> Any:
    data = frame(message)
    frames = Frames(to_process)
    halves = (*frames.feed(data[:3]), *frames.feed(data[3:-1]), *frames.feed(data[-1:]))
    (found,) = halves
    return found


def test_the_state_of_a_bus_passes_the_pipe() -> None:
    bus = bus_live()
    figures = BusFigures(BEGIN, 4.0, 0.25, 0.9, 0.3, units=[UnitFigures(1, 7)])
    bus.apply([*scales(1, BEGIN), *responds(1, BEGIN), Staged(1, BEGIN, 5), figures])
    follower = bus_live()
    changes = through_the_pipe(state_of(bus))
    assert isinstance(changes, Changes)
    follower.apply(changes.updates)
    assert points(follower, BEGIN + 1) == points(bus, BEGIN + 1)
    assert scan_s_of(follower) == scan_s_of(bus) == 0.25
    assert follower.figures is not None
    assert follower.figures.units == [], "what nobody needs there does not pass"


def test_a_pipe_that_delivers_something_else_is_refused() -> None:
    with pytest.raises(ValueError, match="too long"):
        list(Frames(to_process).feed(b"\xff\xff\xff\xff"))
    with pytest.raises(ValueError, match="Expected"):
        list(Frames(to_process).feed(b"\x00\x00\x00\x01\x93"))

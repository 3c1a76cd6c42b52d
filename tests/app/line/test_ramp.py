from __future__ import annotations

from app.line.commands.limits import Limits
from app.line.commands.review import (
    Ramp,
    change_of,
    nudges,
    present_setpoint,
    ramp_of,
    ramp_parameters_missing,
)
from bus.contract import ParameterValue
from tests.app.screens import line, reading

FREE, NOW = Limits(), 100.0


def test_a_change_has_its_start_target_and_duration() -> None:
    bus = line().buses["dry"]
    up = change_of(bus, bus.units[1], 1600, FREE, NOW)
    assert (str(up.old), str(up.new), up.measure, up.ramp) == ("120.0", "160.0", "m/min", Ramp(6, 100, 2.0))
    down = change_of(bus, bus.units[1], 200, FREE, NOW)
    assert down.ramp == Ramp(7, 200, 10.0)
    assert (up.obstacle, up.risks) == (None, ())


def test_a_ramp_that_is_not_known_is_not_guessed() -> None:
    live = line()
    live.buses["dry"].apply([ParameterValue(unit=1, number=6, at=1, raw=None, available=False)])
    bus = live.buses["dry"]
    assert ramp_of(bus.units[1], 1200, 1600) == Ramp(6, None, None)
    assert ramp_of(bus.units[1], None, 1600) == Ramp(6, None, None)
    del bus.units[1].parameters[6]
    assert ramp_parameters_missing(bus.units[1]) == [6]


def test_without_its_span_a_ramp_of_nothing_is_still_known() -> None:
    live = line()
    live.buses["dry"].apply([ParameterValue(unit=1, number=n, at=1, raw=raw) for n, raw in ((2, 0), (6, 0))])
    unit = live.buses["dry"].units[1]
    assert ramp_of(unit, 1200, 1600) == Ramp(6, 0, 0.0)
    assert ramp_of(unit, 1200, 800) == Ramp(7, 200, None)
    assert ramp_of(unit, 1200, 1200) is None


def test_the_range_is_shown_with_the_change() -> None:
    bus = line().buses["dry"]
    free = change_of(bus, bus.units[1], 1600, FREE, NOW)
    assert (str(free.lowest), str(free.highest)) == ("0.0", "200.0")
    limited = change_of(bus, bus.units[1], 1600, Limits(lowest=100, highest=2500), NOW)
    assert (str(limited.lowest), str(limited.highest)) == ("10.0", "250.0")


def test_a_follower_s_setpoint_is_its_ratio() -> None:
    live = line()
    live.buses["dry"].apply(
        [ParameterValue(unit=1, number=8, at=1, raw=1), ParameterValue(unit=1, number=37, at=1, raw=10250)]
    )
    bus = live.buses["dry"]
    assert present_setpoint(bus, bus.units[1]) == 10250
    change = change_of(bus, bus.units[1], 10300, FREE, NOW)
    assert (str(change.old), str(change.new), change.measure, change.ramp) == ("1.0250", "1.0300", "", None)


def test_nudges_suit_the_span() -> None:
    live = line()
    assert nudges(live.buses["dry"].units[1]) == (2, 20)
    live.buses["dry"].apply([ParameterValue(unit=1, number=2, at=1, raw=50), reading(1)])
    assert nudges(live.buses["dry"].units[1]) == (1, 1)

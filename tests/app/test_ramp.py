from __future__ import annotations

from app.commands.limits import Limits
from app.commands.ramp import change_of, nudges, present_setpoint, ramp_parameters_missing
from bus.contract import ParameterValue
from tests.app.screens import line, reading

FREE = Limits()


def test_a_change_says_from_where_to_where_and_how_long() -> None:
    bus = line().buses["dry"]
    up = change_of(bus, bus.units[1], 1600, FREE)
    assert (up.old, up.new, up.seconds, up.ramp.number) == ("120.0", "160.0", 2.0, 6)
    down = change_of(bus, bus.units[1], 200, FREE)
    assert (down.seconds, down.ramp.number) == (10.0, 7)


def test_a_ramp_that_is_not_known_is_not_guessed() -> None:
    live = line()
    live.apply("dry", [ParameterValue(unit=1, number=6, at=1, raw=None, available=False)])
    bus = live.buses["dry"]
    assert change_of(bus, bus.units[1], 1600, FREE).seconds is None
    del bus.units[1].parameters[6]
    assert ramp_parameters_missing(bus.units[1]) == [6]


def test_a_follower_s_setpoint_is_its_ratio() -> None:
    live = line()
    live.apply(
        "dry",
        [ParameterValue(unit=1, number=8, at=1, raw=1), ParameterValue(unit=1, number=37, at=1, raw=10250)],
    )
    bus = live.buses["dry"]
    assert present_setpoint(bus, bus.units[1]) == 10250
    change = change_of(bus, bus.units[1], 10300, FREE)
    assert (change.old, change.new, change.seconds) == ("1.0250", "1.0300", None)


def test_nudges_suit_the_span() -> None:
    live = line()
    assert nudges(live.buses["dry"].units[1]) == (2, 20)
    live.apply("dry", [ParameterValue(unit=1, number=2, at=1, raw=50), reading(1)])
    assert nudges(live.buses["dry"].units[1]) == (1, 1)

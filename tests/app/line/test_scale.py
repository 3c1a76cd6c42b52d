"""What a value was shown with: as a form holds it, and when it counts as old."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.web.formats import UNKNOWN
from app.errors import Problem
from app.line.alarms.own_condition import known_decimals
from app.line.commands.limits import NO_LIMITS
from app.line.commands.review import change_of
from app.line.commands.values import parse_scale, raw_of_percent, scale_text, scales_of
from app.line.live.bus_live import BusLive
from app.line.live.fields import unit_fields
from bus.contract import (
    ParameterValue,
    SetLine,
    SetSpeed,
    Staged,
    UnitLink,
    WriteAnalogOutput,
    WriteParameter,
)
from bus.errors import CallerError
from bus.instants import UnixTime
from tests.app.screens import line, reading, translator

SCALES = st.dictionaries(st.integers(1, 40), st.none() | st.integers(0, 0xFFFF_FFFF), max_size=6)


@given(SCALES)
def test_a_form_holds_what_the_review_was_made_with(scale: dict[int, int | None]) -> None:
    assert parse_scale(scale_text(scale)) == scale


@pytest.mark.parametrize(
    "text",
    [None, "", "3", "3:", "3:x", "3:1,", ",3:1", "41:1", "0:1", "3:99999999999", "3:-1", "3 :1", "³:1"],
)
def test_what_no_review_holds_is_refused(text: str | None) -> None:
    with pytest.raises(Problem, match="differs from the review"):
        parse_scale(text)


@pytest.fixture
def bus() -> BusLive:
    bus = line().buses["dry"]
    bus.apply([reading(), *(read(number, raw) for number, raw in {2: 20000, 3: 1, 8: 0, 6: 50}.items())])
    return bus


def read(number: int, raw: int | None, at: float = 100.0) -> ParameterValue:
    return ParameterValue(unit=1, number=number, at=UnixTime(at), raw=raw)


def test_what_converts_and_bounds_each_kind_of_value(bus: BusLive) -> None:
    assert scales_of(SetSpeed(1, 1200), bus) == {1: {2: 20000, 8: 0, 3: 1}}
    assert scales_of(SetLine({1: 1200}), bus) == {1: {2: 20000, 8: 0, 3: 1}}
    assert scales_of(WriteParameter(1, 12, 5), bus) == {1: {3: 1}}
    assert scales_of(WriteParameter(1, 9, 5), bus) == {1: {8: 0, 3: 1}}
    assert scales_of(WriteParameter(1, 6, 50), bus) == {1: {}}
    assert scales_of(SetSpeed(1, 0), bus) == {1: {}}, "nothing keeps a line from being set to zero"
    bus.apply([read(28, 2), read(29, 100), read(30, 2000)])
    assert scales_of(WriteAnalogOutput(1, 350), bus) == {1: {28: 2, 29: 100, 30: 2000}}
    bus.apply([read(8, 1), read(31, 20000), read(38, 5000)])
    assert scales_of(SetSpeed(1, 12000), bus) == {1: {38: 5000, 31: 20000, 8: 1}}


def state_text(bus: BusLive) -> str:
    return str(unit_fields(bus, bus.units[1], "online", translator())["state_text"])


def test_a_speed_is_not_shown_before_its_decimals_are_read(bus: BusLive) -> None:
    unit = bus.units[1]
    bus.apply([reading(1, 1.0)])
    assert unit_fields(bus, unit, "online", translator())["actual"] == "120.0"
    unit.parameters.clear()
    fields = unit_fields(bus, unit, "online", translator())
    assert [fields[name] for name in ("actual", "commanded", "deviation")] == [UNKNOWN] * 3
    assert "scale is being read" in fields["state_text"]


def test_one_parameter_changed_at_the_keypad_makes_the_scale_old_until_it_is_read_again(bus: BusLive) -> None:
    unit = bus.units[1]
    assert not unit.scale_is_old
    bus.apply([read(6, 60, at=101.0)])
    assert unit.scale_is_old
    assert "scale is being read again" in state_text(bus)
    assert known_decimals(bus, unit) is None, "an alarm of the site is judged in no scale that may be another"
    bus.apply([read(number, unit.parameters[number].raw or 0, at=102.0) for number in list(unit.parameters)])
    assert not unit.scale_is_old
    assert "scale" not in state_text(bus)
    assert known_decimals(bus, unit) == 1


def test_a_reading_whose_decimals_were_never_read_says_so() -> None:
    bus = line().buses["dry"]
    bus.units[1].parameters.clear()
    assert "scale is being read" in state_text(bus)
    bus.apply([read(3, None)])
    assert "scale" not in state_text(bus), "a unit may lack them"


def test_a_setpoint_that_a_host_has_changed_is_no_change_at_the_keypad(bus: BusLive) -> None:
    bus.apply([read(20, 500), read(20, 600, at=101.0)])
    assert not bus.units[1].scale_is_old


def test_an_absence_makes_the_scale_old_and_a_staged_speed_unknown(bus: BusLive) -> None:
    unit = bus.units[1]
    bus.apply([Staged(1, UnixTime(100.0), 700)])
    assert unit_fields(bus, unit, "online", translator())["staged"] == "70.0"
    bus.apply([UnitLink(1, UnixTime(101.0), "offline"), Staged(1, UnixTime(101.0), None, unknown=True)])
    assert unit_fields(bus, unit, "offline", translator())["staged"] == "?"
    assert not unit.scale_is_old
    bus.apply([UnitLink(1, UnixTime(102.0), "online")])
    assert unit.scale_is_old
    assert unit.staged_unknown
    bus.apply([Staged(1, UnixTime(103.0), 800)])
    assert (unit.staged, unit.staged_unknown) == (800, False)


@pytest.mark.parametrize(
    ("text", "raw"),
    [
        ("105 %", 1260),
        ("105%", 1260),
        ("+5 %", 1260),
        ("-5%", 1140),
        ("97,5 %", 1170),
        ("0.04 %", 0),
        ("0,05%", 1),
    ],
)
def test_percent_are_of_the_unit_s_own_setpoint(text: str, raw: int) -> None:
    assert raw_of_percent(text, 1200) == raw


@pytest.mark.parametrize("text", ["%", "x %", "-101 %", "5 % 5 %", "99999 %", "1.2345 %", "--5 %"])
def test_what_is_no_percentage_is_refused_with_what_would_be_right(text: str) -> None:
    with pytest.raises(CallerError, match="105 % is five percent more"):
        raw_of_percent(text, 1200)


def test_a_percentage_of_a_setpoint_that_is_not_known_is_refused() -> None:
    with pytest.raises(CallerError, match="present setpoint is not known"):
        raw_of_percent("105 %", None)


def test_the_review_of_a_typed_setpoint_keeps_the_scale_that_it_was_converted_with(bus: BusLive) -> None:
    """Also where the unit was found with another one until the review is there."""
    unit = bus.units[1]
    typed_with = scales_of(SetSpeed(1, 1000), bus)[1]
    bus.apply([read(3, 0, at=101.0)])
    change = change_of(bus, unit, 1000, NO_LIMITS, UnixTime(101.0), typed_with=typed_with)
    assert parse_scale(change.scale) == {2: 20000, 8: 0, 3: 1}
    assert parse_scale(change_of(bus, unit, 0, NO_LIMITS, UnixTime(101.0), typed_with={}).scale) == {}

"""The state of each unit, and its updates to the app."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.contract import ParameterValue, Reading, Staged, UnitLink
from bus.line.roster import ResponseTimes, Roster
from bus.messages import Message
from bus.wire.commands import (
    Ack,
    ExecuteSpeedRequest,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    StatusReply,
    WriteOutputRequest,
)

STATUS = StatusReply(1, 500, 498, 77, 0xC1, 0x03)
PULLED = Message("adapter_gone")


@pytest.fixture
def roster() -> Roster:
    return Roster([1, 2], at=100.0)


def links(updates: list[object]) -> list[str]:
    return [update.link for update in updates if isinstance(update, UnitLink)]


def test_a_unit_that_never_responded_is_unknown(roster: Roster) -> None:
    assert [state.link.link for state in roster.states()] == ["unknown", "unknown"]
    assert roster.states()[0].reading is None


def test_a_response_makes_it_online_and_gives_a_reading(roster: Roster) -> None:
    updates = roster.take_response(ReadStatusRequest(1), STATUS, 101.0, b"")
    assert links(updates) == ["online"]
    assert Reading(1, 101.0, 500, 498, 77, 0xC1, 0x03) in updates
    assert links(roster.take_response(ReadStatusRequest(1), STATUS, 102.0, b"")) == [], "changes only"


def test_one_miss_is_not_reported_two_are_stale_three_are_offline(roster: Roster) -> None:
    roster.take_response(ReadStatusRequest(1), STATUS, 101.0, b"")
    reported = [links(roster.missed(1, 102.0 + miss)) for miss in range(4)]
    assert reported == [[], ["stale"], ["offline"], []]


def test_a_short_burst_of_noise_loses_no_unit(roster: Roster) -> None:
    roster.take_response(ReadStatusRequest(1), STATUS, 101.0, b"")
    reported = [links(roster.missed(1, 101.1 + miss / 10)) for miss in range(5)]
    assert reported == [[], ["stale"], [], [], []]
    assert roster[1].unresponsive
    assert links(roster.take_response(ReadStatusRequest(1), STATUS, 101.7, b"")) == ["online"]
    assert not roster[1].unresponsive


def test_misses_are_counted_in_a_row(roster: Roster) -> None:
    roster.take_response(ReadStatusRequest(1), STATUS, 101.0, b"")
    for _ in range(5):
        assert roster.missed(1, 102.0) == []
        roster.take_response(ReadStatusRequest(1), STATUS, 103.0, b"")


def test_an_offline_unit_keeps_its_last_reading_with_its_age(roster: Roster) -> None:
    roster.take_response(ReadStatusRequest(1), STATUS, 101.0, b"")
    for _ in range(3):
        roster.missed(1, 102.0)
    assert roster.states()[0].reading is not None
    assert roster.states()[0].reading.at == 101.0


def test_a_parameter_comes_with_its_frame(roster: Roster) -> None:
    updates = roster.take_response(ReadParameterRequest(1, 6), ParameterReply(1, 50), 101.0, b"frame")
    assert ParameterValue(1, 6, 101.0, 50, frame=b"frame") in updates
    assert roster[1].raw(6) == 50


def test_a_parameter_that_it_does_not_have_is_reported_as_unavailable(roster: Roster) -> None:
    updates = roster.take_response(ReadParameterRequest(1, 38), Nak(1, 0x82), 101.0, b"f")
    assert ParameterValue(1, 38, 101.0, None, available=False, frame=b"f") in updates
    assert roster[1].raw(38) is None


def test_another_refusal_does_not_change_the_parameter(roster: Roster) -> None:
    roster.take_response(ReadParameterRequest(1, 38), Nak(1, 0x89), 101.0, b"f")
    assert roster[1].parameters == {}


def test_a_probe_reports_that_a_unit_responds_and_no_parameters(roster: Roster) -> None:
    """A unit that counts in BCD takes 23 (17h) for #17, and 64 (40h) for #40."""
    updates = roster.take_response(
        ReadParameterRequest(1, 23), ParameterReply(1, 1), 101.0, b"", is_probe=True
    )
    updates += roster.take_response(ReadParameterRequest(1, 64), ParameterReply(1, 200), 102.0, b"")
    updates += roster.take_response(ReadParameterRequest(1, 64), Nak(1, 0x82), 103.0, b"")
    assert links(updates) == ["online"]
    assert [update for update in updates if isinstance(update, ParameterValue)] == []
    assert roster.states()[0].parameters == []


def test_staged_until_executed(roster: Roster) -> None:
    assert Staged(1, 101.0, 640) in roster.take_response(StageSpeedRequest(1, 640), Ack(1), 101.0, b"")
    assert roster[1].staged == 640
    assert roster.take_response(StageSpeedRequest(1, 700), Nak(1, 0x81), 102.0, b"") == []
    assert roster[1].staged == 640, "a refused stage changes nothing"
    assert Staged(1, 103.0, None) in roster.take_response(ExecuteSpeedRequest(1), Ack(1), 103.0, b"")
    roster.take_response(StageSpeedRequest(1, 640), Ack(1), 104.0, b"")
    assert Staged(1, 105.0, None) in roster.take_response(SetAndExecuteSpeedRequest(1, 5), Ack(1), 105.0, b"")
    assert roster.stage(1, None, 106.0) == []


def test_other_writes_leave_the_staged_speed(roster: Roster) -> None:
    roster.take_response(StageSpeedRequest(1, 640), Ack(1), 101.0, b"")
    roster.take_response(WriteOutputRequest(1, 1, True), Ack(1), 102.0, b"")
    assert roster[1].staged == 640


def test_a_closed_port_makes_stale_and_then_offline(roster: Roster) -> None:
    roster.take_response(ReadStatusRequest(1), STATUS, 101.0, b"")
    assert links(roster.port_closed(102.0, PULLED)) == ["stale"]
    assert links(roster.port_closed(102.5, PULLED)) == []
    assert links(roster.port_closed(105.0, PULLED, long=True)) == ["offline"]
    assert roster.states()[0].link.cause == PULLED
    assert roster.states()[1].link.link == "unknown", "never seen stays never seen"


def test_an_unconfigured_unit_is_known_but_not_reported(roster: Roster) -> None:
    assert roster.take_response(ReadStatusRequest(9), StatusReply(9, 1, 1, 0, 0, 0), 101.0, b"") == []
    assert roster[9].reading is not None
    assert [state.unit for state in roster.states()] == [1, 2]


@given(st.lists(st.floats(0, 5.0), min_size=1, max_size=200))
def test_quantiles_are_within_a_class_of_the_truth(seconds: list[float]) -> None:
    times = ResponseTimes()
    for each in seconds:
        times.add(each)
    median = times.quantile(0.5)
    assert median is not None
    assert times.smallest == min(seconds)
    assert times.largest == max(seconds)
    true = sorted(seconds)[(len(seconds) + 1) // 2 - 1]
    assert median == pytest.approx(true, rel=0.09, abs=0.0002)


def test_no_response_has_no_quantile() -> None:
    assert ResponseTimes().quantile(0.5) is None

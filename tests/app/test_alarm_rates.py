"""A flood of alarms, and one that chatters."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from app.alarms.rules.performance import CHATTERS_S, FEW, MANY, WINDOW_S
from app.alarms.rules.rates import AlarmRates
from bus.instants import UnixTime


def at(seconds: float) -> UnixTime:
    return UnixTime(1e9 + seconds)


def test_a_flood_begins_with_more_than_ten_in_ten_minutes_and_ends_with_fewer_than_five() -> None:
    rates = AlarmRates()
    for second in range(MANY):
        rates.note(f"alarm-{second}", at(second))
    assert rates.flood(at(MANY)) == 0
    rates.note("one more", at(MANY))
    assert rates.flood(at(MANY)) == MANY + 1
    still = at(WINDOW_S + MANY - FEW + 0.5)
    assert rates.flood(still) == FEW
    assert rates.flood(still + 1.0) == 0
    rates.note("later", still + 2.0)
    assert rates.flood(still + 2.0) == 0, "the next flood begins with more than ten, too"


def test_an_alarm_chatters_that_came_three_times_within_a_minute() -> None:
    rates = AlarmRates()
    for second in (0, 30, CHATTERS_S):
        assert not rates.chatters("a", at(second))
        rates.note("a", at(second))
    assert rates.chatters("a", at(CHATTERS_S))
    assert not rates.chatters("b", at(CHATTERS_S))
    assert not rates.chatters("a", at(CHATTERS_S + WINDOW_S)), "it was long ago"
    rates.note("a", at(200))
    assert not rates.chatters("a", at(200))


@given(st.lists(st.floats(-1e6, 1e6), max_size=40), st.floats(-1e6, 1e6))
def test_whatever_the_clock_does_no_more_are_counted_than_came(times: list[float], now: float) -> None:
    rates = AlarmRates()
    for each in times:
        rates.note("a", at(each))
    assert 0 <= rates.count(at(now)) <= len(times)
    assert rates.flood(at(now)) in (0, rates.count(at(now)))

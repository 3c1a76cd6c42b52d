"""The figures of the alarm system, from a journal that is written by hand."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.alarms.journal import AlarmPerformance, measure
from app.line.alarms.rules.performance import (
    CHATTERS_S,
    FEW,
    MANY,
    MAX_GAP_S,
    MIN_FOR_TOP_TEN,
    WINDOW_S,
    AlarmCounts,
    AlarmRates,
    ObservedSpan,
    figures,
    flooded,
    observed_until,
)
from bus.instants import UnixTime
from tests.app.alarm_journal import Journal, T, alarm_journal


def values(performance: AlarmPerformance) -> dict[str, float | None]:
    return {figure.code: figure.value for figure in performance.figures}


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with alarm_journal(tmp_path) as journal:
        yield journal


async def performance_of(journal: Journal, seconds: float) -> AlarmPerformance:
    return await measure(journal.store, [], journal.spans, UnixTime(T), UnixTime(T + seconds))


async def measured(journal: Journal, seconds: float) -> dict[str, float | None]:
    return values(await performance_of(journal, seconds))


async def test_rates_peak_and_priorities(journal: Journal) -> None:
    journal.rise("a", 0, 700, 1300, priority="high")
    journal.rise("b", *range(10, 130, 10))
    found = await measured(journal, 1800)
    assert (found["annunciated"], found["per_10_minutes"], found["per_day"]) == (15, 5, 720)
    assert (found["peak_10_minutes"], found["windows_over_10"]) == (13, pytest.approx(1 / 3))
    assert (found["high_share"], found["low_share"], found["urgent_share"]) == (0.2, 0.8, 0)


async def test_an_empty_journal_has_no_shares_and_meets_no_target_by_them(journal: Journal) -> None:
    performance = await performance_of(journal, 600)
    assert values(performance)["low_share"] is None
    assert {figure.code: figure.met for figure in performance.figures}["low_share"] is None
    assert {figure.code: figure.met for figure in performance.figures}["per_day"] is True


async def test_three_times_in_a_minute_chatters(journal: Journal) -> None:
    journal.rise("chatters", 0, 30, 60)
    journal.rise("often", 0, 40, 80)
    assert (await measured(journal, 600))["chattering"] == 1


async def test_what_clears_before_a_person_could_act_is_fleeting(journal: Journal) -> None:
    for alarm, clears_at in (("fleeting", 10), ("lasting", 11)):
        journal.write(
            alarm,
            (0, "rise", "normal", "unack_active"),
            (clears_at, "clear", "unack_active", "rtn_unack"),
        )
    journal.rise("acknowledged", 0)
    assert (await measured(journal, 600))["fleeting"] == 1


async def test_the_median_until_it_is_acknowledged(journal: Journal) -> None:
    for alarm, after_s in (("a", 10), ("b", 30), ("c", 500), ("d", 40)):
        journal.write(
            alarm,
            (0, "rise", "normal", "unack_active"),
            (after_s, "acknowledge", "unack_active", "ack_active"),
        )
    assert (await measured(journal, 600))["acknowledge_median_s"] == 35


async def test_a_hidden_alarm_is_not_counted_until_it_is_annunciated(journal: Journal) -> None:
    journal.write(
        "a", (0, "rise", "suppressed", "suppressed"), (5, "unsuppress", "suppressed", "unack_active")
    )
    journal.write("b", (0, "rise", "shelved", "shelved"))
    assert (await measured(journal, 600))["annunciated"] == 1


async def test_a_rate_is_of_the_time_that_was_observed(journal: Journal) -> None:
    """The server ran for the first ten minutes of a week and, a day later, for twenty."""
    later = UnixTime(T + 86_400)
    await journal.store.write_observed("_", ObservedSpan(UnixTime(T - 60), UnixTime(T + 600)))
    await journal.store.write_observed("dry-end", ObservedSpan(UnixTime(T), UnixTime(T + 600)))
    journal.spans = [ObservedSpan(later, UnixTime(later + 1200))]
    journal.rise("a", 1200, 86_400 + 30)
    performance = await performance_of(journal, 7 * 86_400)
    assert (performance.start, performance.observed_s) == (T, 1800)
    assert values(performance)["per_10_minutes"] == pytest.approx(2 / 3)
    assert (performance.is_observed, performance.covers(7 * 86_400)) == (True, False)
    assert [(top.alarm, top.times) for top in performance.most_frequent] == [("a", 2)]


@pytest.mark.parametrize("observed_s", [0, 599])
async def test_what_was_not_observed_meets_no_target(journal: Journal, observed_s: float) -> None:
    journal.spans = [ObservedSpan(UnixTime(T), UnixTime(T + observed_s))]
    performance = await performance_of(journal, 7 * 86_400)
    assert not performance.is_observed
    judged = {figure.code for figure in performance.figures if figure.met is not None}
    assert judged == {"stale"}, "which is of the present"
    assert [code for code, value in values(performance).items() if value is not None] == [
        *("stale", "standing", "shelved", "suppressed", "out_of_service")
    ]


def test_alarms_are_observed_while_the_engine_looks_every_second() -> None:
    span = observed_until(UnixTime(T), None)
    assert observed_until(UnixTime(T + 1), span) == (T, T + 1)
    assert observed_until(UnixTime(T + MAX_GAP_S + 1), span) == (T + MAX_GAP_S + 1,) * 2
    assert observed_until(UnixTime(T - 1), span) == (T - 1, T - 1)


def test_a_flood_lasts_until_a_window_with_fewer_than_five() -> None:
    assert list(flooded({1: 10, 2: 11, 3: 5, 4: 4, 5: 9, 7: 30, 9: 6})) == [2, 3, 7]


def test_each_figure_has_at_most_one_target() -> None:
    found = figures(AlarmCounts(600, {1: 3}, 3, {"urgent": 3}, 0, 0, 700, {"stale": 5}))
    assert {figure.code for figure in found if figure.met is False} == {
        *("per_day", "per_10_minutes", "stale", "urgent_share", "low_share"),
        "acknowledge_median_s",
    }
    assert not [figure for figure in found if figure.at_most is not None and figure.at_least is not None]


@pytest.mark.parametrize(("total", "share"), [(MIN_FOR_TOP_TEN - 1, None), (MIN_FOR_TOP_TEN, 0.05)])
def test_the_ten_most_frequent_are_judged_where_they_can_keep_their_target(
    total: int, share: float | None
) -> None:
    found = figures(AlarmCounts(86_400, {1: total}, 10, {"low": total}, 0, 0, None, {}))
    (top_ten,) = [figure for figure in found if figure.code == "top_ten_share"]
    assert (top_ten.value, top_ten.met) == (share, None if share is None else True)


def moment(seconds: float) -> UnixTime:
    return UnixTime(1e9 + seconds)


def test_a_flood_begins_with_more_than_ten_in_ten_minutes_and_ends_with_fewer_than_five() -> None:
    rates = AlarmRates()
    for second in range(MANY):
        rates.note(f"alarm-{second}", moment(second))
    assert rates.flood(moment(MANY)) == 0
    rates.note("one more", moment(MANY))
    assert rates.flood(moment(MANY)) == MANY + 1
    still = moment(WINDOW_S + MANY - FEW + 0.5)
    assert rates.flood(still) == FEW
    assert rates.flood(still + 1.0) == 0
    rates.note("later", still + 2.0)
    assert rates.flood(still + 2.0) == 0, "the next flood begins with more than ten, too"


def test_an_alarm_chatters_that_came_three_times_within_a_minute() -> None:
    rates = AlarmRates()
    for second in (0, 30, CHATTERS_S):
        assert not rates.chatters("a", moment(second))
        rates.note("a", moment(second))
    assert rates.chatters("a", moment(CHATTERS_S))
    assert not rates.chatters("b", moment(CHATTERS_S))
    assert not rates.chatters("a", moment(CHATTERS_S + WINDOW_S)), "it was long ago"
    rates.note("a", moment(200))
    assert not rates.chatters("a", moment(200))


@given(st.lists(st.floats(-1e6, 1e6), max_size=40), st.floats(-1e6, 1e6))
def test_whatever_the_clock_does_no_more_are_counted_than_came(times: list[float], now: float) -> None:
    rates = AlarmRates()
    for each in times:
        rates.note("a", moment(each))
    assert 0 <= rates.count(moment(now)) <= len(times)
    assert rates.flood(moment(now)) in (0, rates.count(moment(now)))

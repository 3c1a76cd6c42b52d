"""Bits as intervals, exact whichever way the minutes came."""

from __future__ import annotations

from itertools import pairwise, permutations

from hypothesis import given
from hypothesis import strategies as st

from app.line.history.series.runs import MINUTE, SECOND, Run
from app.line.history.series.values import Interval, Marks, intervals, splice

WORDS = st.lists(st.integers(0, 2), min_size=36, max_size=36)


def polls(words: list[int]) -> list[Run]:
    """One reading every five seconds, three minutes long."""
    times = (position * 5 * SECOND for position in range(len(words)))
    return [Run(at, at, 1, 0, 0, 0, word) for at, word in zip(times, words, strict=True)]


def parts_of(runs: list[Run]) -> list[Interval]:
    return [Interval(run.at, run.until, run.word) for run in runs]


@given(WORDS)
def test_an_interval_holds_one_state_from_first_to_last(words: list[int]) -> None:
    runs = polls(words)
    parts = intervals(parts_of(runs), Marks(), 5 * SECOND)
    assert all(any(p.at <= run.at <= p.until and p.word == run.word for p in parts) for run in runs)
    assert all(a.word != b.word and a.until < b.at for a, b in pairwise(parts))


@given(WORDS, st.permutations([0, 1, 2]))
def test_minutes_in_any_order_make_the_same_intervals(words: list[int], order: list[int]) -> None:
    runs = polls(words)
    stored: list[Interval] = []
    for number in order:
        minute = number * MINUTE
        of_minute = [run for run in runs if run.at // MINUTE == number]
        stored = splice(stored, minute, of_minute, Marks())
    assert stored == intervals(parts_of(runs), Marks(), 5 * SECOND)


def test_one_state_over_three_minutes_is_one_interval_in_every_order() -> None:
    runs = polls([1] * 36)
    for order in permutations(range(3)):
        stored: list[Interval] = []
        for number in order:
            minute = number * MINUTE
            stored = splice(stored, minute, [r for r in runs if r.at // MINUTE == number], Marks())
        assert stored == [Interval(0, runs[-1].at, 1)], order


def test_a_minute_folded_again_changes_nothing() -> None:
    runs = polls([0, 1, 1, 2] * 9)
    stored: list[Interval] = []
    for number in (0, 1, 2, 1):
        stored = splice(stored, number * MINUTE, [r for r in runs if r.at // MINUTE == number], Marks())
    assert stored == intervals(parts_of(runs), Marks(), 5 * SECOND)


def test_a_pause_ends_an_interval() -> None:
    runs = polls([1] * 12)
    lost = Marks(lost=[runs[5].at + SECOND])
    assert intervals(parts_of(runs), lost, 5 * SECOND) == [
        Interval(0, runs[5].at, 1),
        Interval(runs[6].at, runs[11].at, 1),
    ]

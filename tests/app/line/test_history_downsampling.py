"""Downsampling: at most so many points, the extremes kept, on a fixed grid."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from app.line.history.series.downsampling import Points, downsample, grid, in_order, series
from app.line.history.series.runs import HOUR, MINUTE, SECOND
from app.line.history.series.values import LinearScale, Marks, Scaling

PLAIN = Scaling([0], [LinearScale(decimals=0)])


def points(values: dict[int, int]) -> Points:
    at, each = sorted(values), [values[t] for t in sorted(values)]
    return Points(at, each, each, each, [1] * len(at), [False] * len(at), usual=SECOND)


@given(
    st.dictionaries(st.integers(0, 10**9), st.integers(-50, 50), min_size=1, max_size=200),
    st.integers(1, 50),
)
def test_nothing_is_cut_off(values: dict[int, int], most: int) -> None:
    thinned = downsample(points(values), 0, 10**9 + 1, most)
    assert len(thinned.at) <= most
    assert min(thinned.least) == min(values.values())
    assert max(thinned.greatest) == max(values.values())
    assert sum(thinned.total) == sum(values.values())
    assert sum(thinned.weight) == len(values)
    assert thinned.at == sorted(set(thinned.at))


@given(st.integers(-(10**15), 10**15), st.integers(1, 10**15), st.integers(1, 20_000))
def test_a_grid_has_no_more_buckets_than_requested(start: int, length: int, most: int) -> None:
    width, origin = grid(start, start + length, most)
    assert -(-(start + length - origin) // width) - (start - origin) // width <= most


def test_the_grid_stays_while_the_span_moves() -> None:
    spans = [(t * SECOND, t * SECOND + 8 * HOUR) for t in range(100)]
    assert {grid(start, end, 1000) for start, end in spans} == {(30 * SECOND, 0)}


def test_rollups_are_not_split() -> None:
    assert grid(0, 10 * MINUTE, 1000, HOUR)[0] == HOUR


def test_a_hole_is_a_null_between() -> None:
    drawn = series(points({0: 1, SECOND: 2, 60 * SECOND: 3}), Marks(), PLAIN)
    assert drawn.average == [1.0, 2.0, None, 3.0]
    assert drawn.at == sorted(drawn.at)


def test_a_continuously_read_value_has_no_gap() -> None:
    steady = points({0: 1, 59 * SECOND: 1})
    steady.solid[0] = True
    assert series(steady, Marks(), PLAIN).average == [1.0, 1.0]
    assert series(downsample(steady, 0, MINUTE, 60), Marks(), PLAIN).average == [1.0, 1.0]


def test_a_falling_scale_swaps_least_and_greatest() -> None:
    falling = Scaling([0], [LinearScale(100, -100, 255)])
    drawn_points = downsample(points({0: 0, 1: 255}), 0, SECOND, 1)
    drawn = series(drawn_points, Marks(), falling)
    assert (drawn.least, drawn.greatest, drawn.average) == ([0.0], [100.0], [50.0])


def test_two_stretches_over_each_other_come_in_order() -> None:
    mixed = Points([5, 7, 6], [1, 2, 3], [1, 2, 3], [1, 2, 3], [1, 1, 1], [False, True, False])
    ordered = in_order(mixed)
    assert (ordered.at, ordered.least, ordered.solid) == ([5, 6, 7], [1, 3, 2], [False, False, True])

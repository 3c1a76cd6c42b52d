"""The points of a chart: at most so many, with the extremes, on a fixed grid; and the draw over time, made of
the stored actual speeds of two units."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from app.line.history.query import SeriesQuery, run_query, stored_queries
from app.line.history.series.figures import Points, Series, downsample, draw_series, grid, in_order, series
from app.line.history.series.runs import HOUR, MINUTE, SECOND, micros
from app.line.history.series.values import LONG_GAP, VALUES, LinearScale, Marks, Scaling
from bus.settings import BusSettings, UnitSettings
from tests.app.history_line import BUS, NOON, Shelf, parameter, reading

PLAIN = Scaling([0], [LinearScale(decimals=0)])


def points(values: dict[int, int]) -> Points:
    at, each = sorted(values), [values[t] for t in sorted(values)]
    return Points(at, each, each, each, [1] * len(at), [False] * len(at), usual=SECOND)


@given(
    st.dictionaries(st.integers(0, 10**9), st.integers(-50, 50), min_size=1, max_size=200), st.integers(1, 50)
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


PAIR = BusSettings(
    name=BUS.name, port=BUS.port, unit=(UnitSettings(id=7, name="Nip"), UnitSettings(id=1, name="Rewind"))
)


def speeds(*points: tuple[int, float | None]) -> Series:
    at, values = [time * SECOND for time, _ in points], [value for _, value in points]
    return Series(at, values, list(values), list(values))


def made(before: Series, section: Series, width: int = 0) -> list[tuple[float, float | None]]:
    found = draw_series(before, section, width * SECOND)
    assert found.least == found.greatest == found.average
    return [(at / SECOND, draw) for at, draw in zip(found.at, found.average, strict=True)]


def test_each_speed_is_held_until_its_next_point() -> None:
    before = speeds((0, 100.0), (10, 100.0), (11, 101.0))
    section = speeds((1, 102.0), (20, 102.0))
    assert made(before, section) == [(0, None), (1, 2.0), (10, 2.0), (11, 0.99), (20, 0.99)]


def test_a_hole_or_a_standstill_of_either_is_a_hole() -> None:
    before = speeds((0, 100.0), (5, None), (9, 100.0), (12, 0.0))
    section = speeds((0, 101.0), (6, 101.0), (10, 101.0), (13, 101.0))
    assert [draw for _, draw in made(before, section)] == [1.0, None, None, 1.0, 1.0, None, None]


def test_after_its_last_point_a_speed_is_not_held_for_long() -> None:
    late = LONG_GAP // SECOND + 1
    assert made(speeds((0, 100.0)), speeds((0, 101.0), (late, 101.0))) == [(0, 1.0), (late, None)]
    assert made(speeds((0, 100.0)), speeds((0, 101.0), (late, 101.0)), 60)[1] == (late, 1.0)


def test_the_store_gives_readings_or_stretches_of_both_units(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path / "history.db")
    shelf.keep([parameter(3, 1, unit=unit) for unit in (1, 7)])
    seconds = range(300)
    shelf.keep([reading(NOON + at, 1000, unit=7) for at in seconds])
    shelf.keep([reading(NOON + at + 0.5, 1020 + at % 2, unit=1) for at in seconds])
    try:
        for most in (2000, 20):
            query = SeriesQuery(PAIR, 1, VALUES["draw"], micros(NOON), micros(NOON + 300), most)
            found = shelf.database.read_now(lambda c, query=query: run_query(c, shelf.tail, query))
            draws = [draw for draw in found.series.average[1:] if draw is not None]
            assert len(found.series.at) <= most
            assert draws
            assert all(2.0 <= draw <= 2.1 for draw in draws)
            assert found.decimals == 2
    finally:
        shelf.close()


def test_a_draw_is_stored_as_two_speeds() -> None:
    query = SeriesQuery(PAIR, 1, VALUES["draw"], 0, 1, 10)
    assert [(each.unit, each.value.name) for each in stored_queries(query)] == [(7, "actual"), (1, "actual")]

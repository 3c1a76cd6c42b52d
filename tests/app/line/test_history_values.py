"""Stored values: runs and rollups, and what charts make of them: gaps, bits, scales, points and the draw."""

from __future__ import annotations

from itertools import pairwise, permutations
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.history.query import SeriesQuery, run_query, stored_queries
from app.line.history.series.figures import Points, Series, downsample, draw_series, grid, in_order, series
from app.line.history.series.runs import (
    FIELDS,
    HOUR,
    MINUTE,
    SECOND,
    Rollup,
    Run,
    combine,
    follows,
    joined,
    merge,
    micros,
    minute_rollups,
    pack_columns,
    pack_integers,
    pack_rollups,
    plain_run,
    replace_rows,
    rollup,
    unpack_columns,
    unpack_integers,
    unpack_rollups,
    unpack_runs,
)
from app.line.history.series.values import (
    LONG_GAP,
    VALUES,
    Interval,
    LinearScale,
    Marks,
    ParameterStep,
    Scaling,
    holes,
    intervals,
    scaling,
    splice,
    usual_interval,
)
from bus.contract import Reading
from bus.settings import BusSettings, UnitSettings
from tests.app.history_line import BUS, NOON, Shelf, parameter, reading

POLLS = [i * SECOND // 5 for i in range(100)]
USUAL = SECOND // 5


def without(start: int, end: int) -> list[int]:
    return [at for at in POLLS if not start < at < end]


def test_a_slow_line_has_no_gaps() -> None:
    """255 units at 300 baud respond every three and a half minutes each."""
    times = [i * 213 * SECOND for i in range(20)]
    assert holes(times, Marks(), usual_interval([(at, at, 1) for at in times])) == []


def test_a_reported_loss_makes_a_gap() -> None:
    times = without(4 * SECOND, 8 * SECOND)
    assert holes(times, Marks(lost=[5 * SECOND]), USUAL) == [times.index(4 * SECOND)]


def test_a_short_unreported_pause_is_no_gap() -> None:
    assert holes(without(4 * SECOND, 8 * SECOND), Marks(), USUAL) == []


def test_a_long_pause_is_a_gap_even_when_the_worker_was_gone() -> None:
    times = without(2 * SECOND, 15 * SECOND)
    assert holes(times, Marks(), USUAL) == [times.index(2 * SECOND)]


def test_a_return_after_a_pause_makes_a_gap() -> None:
    times = without(4 * SECOND, 8 * SECOND)
    place = times.index(4 * SECOND)
    assert holes(times, Marks(found=[8 * SECOND]), USUAL) == [place]
    assert holes(times, Marks(found=[8 * SECOND + 100]), USUAL) == [place]
    assert holes(times, Marks(found=[7 * SECOND]), USUAL) == [place]


def test_a_pause_after_the_first_response_is_no_second_gap() -> None:
    """Right after a unit was found its parameters are read."""
    times = [*without(4 * SECOND, 20 * SECOND)[:21], 8 * SECOND, 10 * SECOND, 10 * SECOND + USUAL]
    assert holes(times, Marks(found=[8 * SECOND + 100]), USUAL) == [20]


def test_a_return_without_a_pause_is_no_gap() -> None:
    assert holes(POLLS, Marks(found=[4 * SECOND]), USUAL) == []


def test_a_steady_value_is_read_as_often_as_any() -> None:
    """Runs of a minute each: readings between them carry little information, and may be gaps alone."""
    runs = [(0, 20 * SECOND, 101), (22 * SECOND, 40 * SECOND, 91), (42 * SECOND, 60 * SECOND, 91)]
    assert usual_interval(runs) == USUAL
    assert usual_interval([(0, 0, 1)]) == usual_interval([]) == 0


def test_neighboring_stretches_have_no_gaps() -> None:
    starts = [i * 60 * SECOND for i in range(10)]
    assert holes(starts, Marks(lost=[90 * SECOND]), USUAL, width=60 * SECOND) == []
    assert holes([*starts[:3], *starts[5:]], Marks(), USUAL, width=60 * SECOND) == [2]


def test_losses_outside_of_the_times_make_no_gap() -> None:
    assert holes([10, 20], Marks(lost=[5, 10, 25]), USUAL) == []
    assert holes([], Marks(lost=[5]), USUAL) == []


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


def shown(name: str, raw: int, steps: list[tuple[int, int, int]], at: int = 100, **how: object) -> float:
    bus = BUS.model_copy(update=how)
    return scaling(VALUES[name], [ParameterStep(*step) for step in steps], bus).at(at).apply(raw)


def test_unknown_decimals_leave_the_integer() -> None:
    assert shown("commanded", 12345, []) == 12345
    assert shown("commanded", 12345, [(0, 3, 9)]) == 12345


def test_a_changed_scale_holds_from_when_it_was_read() -> None:
    steps = [(50, 3, 1), (80, 3, 2)]
    assert [shown("actual", 1000, steps, at) for at in (10, 50, 79, 80)] == [100.0, 100.0, 100.0, 10.0]


def test_the_analog_input_spans_low_to_high() -> None:
    steps = [(0, 22, 0), (0, 23, 100)]
    assert [shown("analog", raw, steps) for raw in (0, 51, 255)] == [0.0, 20.0, 100.0]


def test_a_falling_analog_input_is_known_as_such() -> None:
    steps = [ParameterStep(0, 22, 100), ParameterStep(0, 23, 0)]
    assert scaling(VALUES["analog"], steps, BUS).at(0).falling


def test_a_follower_may_speak_in_ratios() -> None:
    steps = [(0, 3, 1), (0, 8, 1)]
    assert shown("commanded", 10_000, steps, follower_speed="ratio") == 1.0
    assert shown("commanded", 10_000, steps, follower_speed="speed") == 1000.0
    assert shown("commanded", 10_000, [(0, 3, 1), (0, 8, 0)], follower_speed="ratio") == 1000.0


def test_an_emergency_stop_is_one_when_it_is_active() -> None:
    assert [shown("estop", raw, []) for raw in (0, 1)] == [1.0, 0.0]
    assert [shown("estop", raw, [], estop_healthy=0) for raw in (0, 1)] == [0.0, 1.0]
    assert [shown("run", raw, []) for raw in (0, 1)] == [0.0, 1.0]


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


AT = st.integers(0, 3 * MINUTE - 1)
READINGS = st.lists(st.tuples(AT, st.integers(0, 3)), max_size=40)


def single(at: int, value: int) -> Run:
    return Run(at, at, 1, value, value * 10, value, value)


def runs_of(readings: list[tuple[int, int]]) -> list[Run]:
    runs: list[Run] = []
    for at, value in sorted(readings):
        run = single(at, value)
        if runs and follows(run, runs[-1]):
            runs[-1] = Run._make(joined(runs[-1], run))
        else:
            runs.append(run)
    return runs


def contains(runs: list[Run], at: int, value: int) -> bool:
    return any(run.at <= at <= run.until and run.commanded == value for run in runs)


def test_a_reading_is_kept_as_sent() -> None:
    reading = Reading(
        unit=7, at=1_795_220_801.123456, commanded=99_999, actual=1, analog=255, outputs=0xC1, inputs=3
    )
    run = Run._make(plain_run(reading))
    assert run == Run(1_795_220_801_123_456, 1_795_220_801_123_456, 1, 99_999, 1, 255, 0xC103)


@given(READINGS)
def test_runs_contain_every_reading(readings: list[tuple[int, int]]) -> None:
    runs = runs_of(readings)
    assert all(contains(runs, at, value) for at, value in readings)
    assert sum(run.readings for run in runs) == len(readings)
    assert all(run.at // MINUTE == run.until // MINUTE for run in runs)


@given(READINGS)
def test_a_block_gives_back_its_runs(readings: list[tuple[int, int]]) -> None:
    runs = runs_of(readings)
    if runs:
        block = pack_columns(list(zip(*runs, strict=True)), 60)
        assert unpack_runs(block, 60) == runs
        at, until, actual = unpack_columns(block, 60, ("at", "until", "actual"))
        assert list(zip(at, until, actual, strict=True)) == [(run.at, run.until, run.actual) for run in runs]


@given(READINGS, READINGS)
def test_merging_loses_no_value(one: list[tuple[int, int]], other: list[tuple[int, int]]) -> None:
    merged = merge(runs_of(one), runs_of(other))
    assert all(contains(merged, at, value) for at, value in one + other)
    assert [run.at for run in merged] == sorted(run.at for run in merged)
    assert merged == merge(runs_of(other), runs_of(one))


@given(READINGS)
def test_a_run_merged_twice_is_there_once(readings: list[tuple[int, int]]) -> None:
    runs = runs_of(readings)
    assert merge(runs, runs) == merge(runs, ())


@given(st.sets(AT, max_size=30), st.integers(0, 30))
def test_late_readings_make_the_same_runs_as_punctual_ones(times: set[int], cut: int) -> None:
    """When no two neighbours are equal there is one way to keep them, whatever came first."""
    readings = [(at, position % 3) for position, at in enumerate(sorted(times))]
    early, late = readings[:cut], readings[cut:]
    merged_runs = merge(map(single, *zip(*readings, strict=True)) if readings else (), ())
    assert merge([single(*r) for r in late], [single(*r) for r in early]) == merged_runs


NUMBERS = st.integers(-(2**61), 2**61)


@st.composite
def tables(draw: st.DrawFn) -> list[list[int]]:
    rows = draw(st.integers(0, 40))
    column = st.lists(draw(st.sampled_from([NUMBERS, st.integers(0, 3)])), min_size=rows, max_size=rows)
    return draw(st.lists(column, min_size=1, max_size=6))


@given(tables())
def test_packed_columns_are_unpacked_as_they_were(table: list[list[int]]) -> None:
    assert unpack_integers(pack_integers(table)) == table


@given(tables())
def test_single_columns_can_be_requested(table: list[list[int]]) -> None:
    last = len(table) - 1
    assert unpack_integers(pack_integers(table), [last, 0]) == [table[last], table[0]]


@given(tables(), st.binary(max_size=30), st.integers(0, 200))
def test_damaged_columns_are_refused(table: list[list[int]], noise: bytes, cut: int) -> None:
    packed = pack_integers(table)
    for damaged in (noise, packed[: min(cut, len(packed) - 1)], packed[::-1]):
        with pytest.raises(ValueError, match="damaged"):
            unpack_integers(damaged)


def test_a_number_that_cannot_be_held_is_refused() -> None:
    with pytest.raises(OverflowError):
        pack_integers([[2**64]])


def test_an_hour_of_polls_takes_few_bytes() -> None:
    at = [i * 208_000 + (i * 7919) % 1400 for i in range(17_000)]
    actual = [48_000 + (i * 31) % 7 for i in range(17_000)]
    same = [48_000] * 17_000
    assert len(pack_integers([at, actual, same, same, same])) < 4 * 17_000


RUNS = st.lists(
    st.builds(
        lambda at, readings, speed, analog, word: Run(at, at, readings, speed, speed + 1, analog, word),
        st.integers(0, 5 * MINUTE),
        st.integers(1, 300),
        st.integers(0, 99_999),
        st.integers(0, 255),
        st.integers(0, 0xFFFF),
    ),
    min_size=1,
    max_size=30,
)


def by_minute(runs: list[Run]) -> list[Rollup]:
    minutes = sorted({run.at - run.at % MINUTE for run in runs})
    return [rollup([run for run in runs if run.at - run.at % MINUTE == minute], minute) for minute in minutes]


@given(RUNS)
def test_a_rollup_has_least_greatest_and_sum_of_its_readings(runs: list[Run]) -> None:
    row = rollup(runs, 0)
    readings = [run for run in runs for _ in range(run.readings)]
    assert row.readings == len(readings)
    assert (row.actual_min, row.actual_max) == (
        min(r.actual for r in readings),
        max(r.actual for r in readings),
    )
    assert row.commanded_sum == sum(r.commanded for r in readings)
    for bit in range(16):
        states = [r.word >> bit & 1 for r in readings]
        assert row.on[bit] == sum(states)
        assert row.word_and >> bit & 1 == min(states)
        assert row.word_or >> bit & 1 == max(states)


@given(RUNS)
def test_minutes_add_up_to_the_hour(runs: list[Run]) -> None:
    assert minute_rollups(list(zip(*sorted(runs), strict=True))) == by_minute(runs)
    assert combine(by_minute(runs), 0) == rollup(runs, 0)


@given(RUNS)
def test_a_block_gives_back_its_rollups(runs: list[Run]) -> None:
    rows = by_minute(runs)
    assert unpack_rollups(
        pack_rollups([row._replace(start=row.start + HOUR) for row in rows], HOUR), HOUR
    ) == [row._replace(start=row.start + HOUR) for row in rows]


@given(RUNS, RUNS)
def test_a_newer_rollup_of_a_minute_replaces_the_older_one(runs: list[Run], late: list[Run]) -> None:
    minute = late[0].at - late[0].at % MINUTE
    again = rollup([run for run in runs + late if run.at - run.at % MINUTE == minute], minute)
    rows = replace_rows(by_minute(runs), [again])
    assert [row.start for row in rows] == sorted({row.start for row in by_minute(runs)} | {minute})
    assert again in rows


def test_every_column_of_a_packed_row_has_a_place() -> None:
    assert sorted(FIELDS.values()) == list(range(len(Rollup._fields) - 1 + 16))

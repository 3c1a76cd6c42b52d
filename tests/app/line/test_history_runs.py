"""Runs and rollups: equal readings become one run, merging late ones loses no value, an hour made of minutes
equals the hour made of readings, and packing loses nothing."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.history.series.runs import (
    FIELDS,
    HOUR,
    MINUTE,
    Rollup,
    Run,
    combine,
    follows,
    joined,
    merge,
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
from bus.contract import Reading

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

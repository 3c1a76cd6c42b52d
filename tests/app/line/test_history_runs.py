"""Runs: equal readings become one, and merging late ones loses no value."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from app.line.history.series.runs import (
    MINUTE,
    Run,
    follows,
    joined,
    merge,
    pack_columns,
    plain_run,
    unpack_columns,
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
def test_late_readings_make_the_same_as_punctual_ones(times: set[int], cut: int) -> None:
    """When no two neighbours are equal there is one way to keep them, whatever came first."""
    readings = [(at, position % 3) for position, at in enumerate(sorted(times))]
    early, late = readings[:cut], readings[cut:]
    merged_runs = merge(map(single, *zip(*readings, strict=True)) if readings else (), ())
    assert merge([single(*r) for r in late], [single(*r) for r in early]) == merged_runs

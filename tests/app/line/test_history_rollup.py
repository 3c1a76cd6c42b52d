"""Rollups: an hour made of minutes equals the hour made of readings, bit by bit."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from app.line.history.series.rollup import (
    FIELDS,
    Rollup,
    combine,
    minute_rollups,
    pack_rollups,
    replace_rows,
    rollup,
    unpack_rollups,
)
from app.line.history.series.runs import HOUR, MINUTE, Run

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
def test_a_row_has_what_was_read(runs: list[Run]) -> None:
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
def test_a_block_gives_back_its_rows(runs: list[Run]) -> None:
    rows = by_minute(runs)
    assert unpack_rollups(
        pack_rollups([row._replace(start=row.start + HOUR) for row in rows], HOUR), HOUR
    ) == [row._replace(start=row.start + HOUR) for row in rows]


@given(RUNS, RUNS)
def test_a_minute_worked_out_again_takes_the_place_of_the_old(runs: list[Run], late: list[Run]) -> None:
    minute = late[0].at - late[0].at % MINUTE
    again = rollup([run for run in runs + late if run.at - run.at % MINUTE == minute], minute)
    rows = replace_rows(by_minute(runs), [again])
    assert [row.start for row in rows] == sorted({row.start for row in by_minute(runs)} | {minute})
    assert again in rows


def test_every_column_of_a_packed_row_has_a_place() -> None:
    assert sorted(FIELDS.values()) == list(range(len(Rollup._fields) - 1 + 16))

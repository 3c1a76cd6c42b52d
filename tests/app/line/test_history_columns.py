"""Packing of columns: nothing is lost, and little is left of what repeats."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.history.series.columns import pack, unpack

NUMBERS = st.integers(-(2**61), 2**61)


@st.composite
def tables(draw: st.DrawFn) -> list[list[int]]:
    rows = draw(st.integers(0, 40))
    column = st.lists(draw(st.sampled_from([NUMBERS, st.integers(0, 3)])), min_size=rows, max_size=rows)
    return draw(st.lists(column, min_size=1, max_size=6))


@given(tables())
def test_what_was_packed_comes_back(table: list[list[int]]) -> None:
    assert unpack(pack(table)) == table


@given(tables())
def test_single_columns_can_be_requested(table: list[list[int]]) -> None:
    last = len(table) - 1
    assert unpack(pack(table), [last, 0]) == [table[last], table[0]]


@given(tables(), st.binary(max_size=30), st.integers(0, 200))
def test_damage_is_reported(table: list[list[int]], noise: bytes, cut: int) -> None:
    packed = pack(table)
    for damaged in (noise, packed[: min(cut, len(packed) - 1)], packed[::-1]):
        with pytest.raises(ValueError, match="damaged"):
            unpack(damaged)


def test_a_number_that_cannot_be_held_is_refused() -> None:
    with pytest.raises(OverflowError):
        pack([[2**64]])


def test_an_hour_of_polls_takes_few_bytes() -> None:
    at = [i * 208_000 + (i * 7919) % 1400 for i in range(17_000)]
    actual = [48_000 + (i * 31) % 7 for i in range(17_000)]
    same = [48_000] * 17_000
    assert len(pack([at, actual, same, same, same])) < 4 * 17_000

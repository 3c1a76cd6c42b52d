"""In which order the rows of a restore are written: no step on the way is worse than its ends."""

from __future__ import annotations

from itertools import accumulate

from hypothesis import given
from hypothesis import strategies as st

from app.engineering.sets.restore_plan import INVERSE_FOLLOWER, Write, in_order

MASTER, FOLLOWER = 0, 1
Values = dict[int, int]
positive = st.integers(1, 9999)


def steps(present: Values, wanted: Values, mode: int | None = MASTER) -> list[Values]:
    """What the unit holds before, after each write, and at the end."""
    writes = [Write(number, present[number], raw) for number, raw in wanted.items() if raw != present[number]]
    ordered = in_order(writes, mode=mode)
    return list(accumulate(ordered, lambda now, row: now | {row.number: row.wanted}, initial=present))


def order(present: Values, wanted: Values, mode: int | None = MASTER) -> list[int]:
    writes = (Write(number, present[number], wanted[number]) for number in wanted)
    return [write.number for write in in_order(writes, mode=mode)]


def speed(values: Values) -> float:
    """Motor speed of a running master: setpoint * #1 / #2, by the pulses of #5 (protocol.md, 3)."""
    return values[20] * values[1] / values[2] * values[5]


scaling = st.fixed_dictionaries(dict.fromkeys((1, 2, 5, 20), positive))


@given(present=scaling, wanted=scaling)
def test_a_running_master_is_never_faster_than_before_or_afterwards(present: Values, wanted: Values) -> None:
    way = [speed(values) for values in steps(present, wanted)]
    assert max(way) <= max(way[0], way[-1]) * (1 + 1e-9)


def ratio(values: Values, mode: int) -> float:
    """Speed of a follower for one of its master: base ratio * ratio, or divided by it."""
    return values[4] / values[37] if mode == INVERSE_FOLLOWER else values[4] * values[37]


ratios = st.fixed_dictionaries(dict.fromkeys((4, 37), positive))


@given(present=ratios, wanted=ratios, mode=st.sampled_from([FOLLOWER, INVERSE_FOLLOWER]))
def test_a_running_follower_is_never_faster_than_before_or_afterwards(
    present: Values, wanted: Values, mode: int
) -> None:
    way = [ratio(values, mode) for values in steps(present, wanted, mode)]
    assert max(way) <= max(way[0], way[-1]) * (1 + 1e-9)


bounded = st.tuples(positive, positive, positive).map(sorted)


@given(present=bounded, wanted=bounded, mode=st.sampled_from([MASTER, FOLLOWER, INVERSE_FOLLOWER, None]))
def test_a_value_is_within_its_bounds_after_every_write(
    present: list[int], wanted: list[int], mode: int | None
) -> None:
    for low, value, high in ((38, 37, 31), (38, 4, 31)):
        numbers = (low, value, high)
        for now in steps(
            dict(zip(numbers, present, strict=True)), dict(zip(numbers, wanted, strict=True)), mode
        ):
            assert now[low] <= now[value] <= now[high]
    for value in (9, 20):
        now_and_then = ({value: one[1], 2: one[2]} for one in (present, wanted))
        assert all(values[value] <= values[2] for values in steps(*now_and_then, mode))


ends = st.tuples(positive, positive).map(sorted)


@given(present=ends, wanted=ends)
def test_no_step_on_the_way_has_a_low_end_above_its_high_end(present: list[int], wanted: list[int]) -> None:
    for pair in ((22, 23), (29, 30)):
        now, then = (dict(zip(pair, given, strict=True)) for given in (present, wanted))
        assert all(values[pair[0]] <= values[pair[1]] for values in steps(now, then))


def test_the_meaning_comes_first_and_what_ends_the_talk_last() -> None:
    present = dict.fromkeys((3, 8, 6, 9, 16, 18, 19, 21, 27), 0)
    wanted = dict.fromkeys(present, 1)
    assert order(present, wanted) == [16, 3, 8, 6, 9, 21, 27, 18, 19]
    assert order(present | {16: 1}, wanted | {16: 0}) == [3, 8, 6, 9, 16, 21, 27, 18, 19]


@given(numbers=st.permutations([1, 2, 3, 4, 5, 6, 8, 9, 16, 20, 21, 31, 37, 38]))
def test_every_row_is_written_once_in_the_defined_order(numbers: list[int]) -> None:
    ordered = order(dict.fromkeys(numbers, 5), dict.fromkeys(numbers, 9))
    assert sorted(ordered) == sorted(numbers)
    assert ordered == order(dict.fromkeys(sorted(numbers), 5), dict.fromkeys(sorted(numbers), 9))

"""The first of what repeats is noted, and then its number once a minute."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from app.core.server.admission.repeats import MAX_KEYS, WINDOW_S, Repeats, Repetition
from bus.instants import Monotonic

START = Monotonic(1000.0)
SOON = START + WINDOW_S / 2
LATER = START + WINDOW_S
LAST = LATER + WINDOW_S


def test_the_first_is_no_number() -> None:
    repeats = Repeats[str]()
    assert repeats.note("a", "x", START) == Repetition("x", 1, False)
    assert repeats.take_counted(LATER) == []
    assert repeats.note("a", "y", LATER) == Repetition("y", 1, False)


def test_what_follows_is_counted_for_a_minute_and_then_another() -> None:
    repeats = Repeats[int]()
    assert [bool(repeats.note("a", number, START)) for number in range(5)] == [True] + 4 * [False]
    assert repeats.take_counted(SOON) == []
    assert repeats.take_counted(LATER) == [Repetition(4, 4, False)]
    assert repeats.note("a", 5, LATER) is None
    assert repeats.take_counted(LATER) == []
    assert repeats.take_counted(LAST) == [Repetition(5, 1, False)]


def test_each_key_counts_for_itself_and_those_beyond_the_limit_together() -> None:
    repeats = Repeats[str]()
    assert all(repeats.note(number, "", START) for number in range(MAX_KEYS))
    firsts = [repeats.note(f"more {number}", str(number), START) for number in range(50)]
    assert [first for first in firsts if first] == [Repetition("0", 1, True)]
    assert not repeats.note(0, "known", START)
    assert repeats.take_counted(LATER) == [Repetition("known", 1, False), Repetition("49", 49, True)]


def test_at_the_end_everything_is_taken() -> None:
    repeats = Repeats[str]()
    for _ in range(3):
        repeats.note("a", "x", START)
    assert repeats.take_counted(START, everything=True) == [Repetition("x", 2, False)]


@given(st.lists(st.tuples(st.integers(0, 60), st.floats(0, 100)), max_size=60))
def test_nothing_is_lost_or_counted_twice(steps: list[tuple[int, float]]) -> None:
    repeats = Repeats[int](max_keys=20)
    now, noted = START, 0
    for key, step in steps:
        now += step
        first = repeats.note(key, key, now)
        noted += first.count if first else 0
        noted += sum(counted.count for counted in repeats.take_counted(now))
    noted += sum(counted.count for counted in repeats.take_counted(now, everything=True))
    assert noted == len(steps)

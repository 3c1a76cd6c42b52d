"""The first of what repeats is logged, and then its number once a minute."""

from __future__ import annotations

from app.server.repeats import MAX_KEYS, OTHERS, WINDOW_S, Repeats
from bus.instants import Monotonic

START = Monotonic(1000.0)
SOON = START + WINDOW_S / 2
LATER = START + WINDOW_S
LAST = LATER + WINDOW_S


def test_the_first_is_no_number() -> None:
    repeats = Repeats()
    assert repeats.is_first("a", START)
    assert repeats.take_counts(LATER) == {}
    assert repeats.is_first("a", LATER)


def test_what_follows_is_counted_for_a_minute_and_then_another() -> None:
    repeats = Repeats()
    assert [repeats.is_first("a", START) for _ in range(5)] == [True, False, False, False, False]
    assert repeats.take_counts(SOON) == {}
    assert repeats.take_counts(LATER) == {"a": 4}
    assert not repeats.is_first("a", LATER)
    assert repeats.take_counts(LATER) == {}
    assert repeats.take_counts(LAST) == {"a": 1}


def test_each_key_counts_for_itself_and_those_beyond_the_limit_together() -> None:
    repeats = Repeats()
    assert all(repeats.is_first(str(number), START) for number in range(MAX_KEYS))
    assert [repeats.is_first(f"more {number}", START) for number in range(50)].count(True) == 1
    assert not repeats.is_first("0", START)
    assert repeats.take_counts(LATER) == {"0": 1, OTHERS: 49}

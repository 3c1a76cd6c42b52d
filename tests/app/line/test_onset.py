"""Since when a condition holds, and whether that is known or only first seen then."""

from __future__ import annotations

import pytest

from app.line.live.unit_status import Onset, Onsets, WordSpan, later, onset_in

OFF, ON = 0, 1
SEEN = 2.0
"""A change between readings that are at most so far apart has a time."""


def off(word: int) -> bool:
    return word == OFF


def after(*readings: tuple[float, set[str]]) -> dict[str, Onset]:
    onsets = Onsets()
    for at, holding in readings:
        onsets.note(at, frozenset(holding), SEEN)  # type: ignore[arg-type]
    return dict(onsets.since)


def test_a_change_that_was_seen_is_exact() -> None:
    assert after((10.0, set()), (10.2, {"run_off"}), (20.0, {"run_off"})) == {"run_off": Onset(10.2)}


def test_what_held_at_the_first_reading_may_be_older() -> None:
    found = after((10.0, {"run_off"}), (10.2, {"run_off", "turning"}))
    assert found == {"run_off": Onset(10.0, exact=False), "turning": Onset(10.2)}


def test_what_ends_and_begins_again_begins_again() -> None:
    assert after((1.0, {"run_off"}), (2.0, set()), (3.0, {"run_off"})) == {"run_off": Onset(3.0)}


def test_a_change_within_a_gap_has_no_time() -> None:
    assert after((10.0, set()), (13.0, {"run_off"})) == {"run_off": Onset(13.0, exact=False)}


@pytest.mark.parametrize(
    ("back_at", "onset"), [(70.2, Onset(10.2)), (70.3, Onset(70.3, exact=False))], ids=["short", "long"]
)
def test_a_state_equal_before_and_after_a_short_gap_went_on(back_at: float, onset: Onset) -> None:
    found = after((10.0, set()), (10.2, {"run_off"}), (back_at, {"run_off"}))
    assert found == {"run_off": onset}


def test_nothing_that_ended_in_a_long_gap_is_left() -> None:
    assert after((10.0, {"run_off"}), (100.0, set())) == {}


@pytest.mark.parametrize(
    ("spans", "onset", "complete"),
    [
        ([(0, 50, ON), (50.2, 100, OFF)], Onset(50.2), True),
        ([(0, 50, ON), (50.2, 60, OFF), (60.2, 100, OFF)], Onset(50.2), True),
        ([(0, 50, OFF), (50.2, 60, ON), (60.2, 100, OFF)], Onset(60.2), True),
        ([(0, 50, ON), (90, 100, OFF)], Onset(90, exact=False), True),
        ([(0, 20, OFF), (90, 100, OFF)], Onset(90, exact=False), True),
        ([(0, 50, ON), (50.2, 80, OFF)], Onset(50.2), True),
        ([(0, 30, OFF)], Onset(100, exact=False), True),
        ([(50, 100, OFF)], Onset(50, exact=False), False),
        ([], Onset(100, exact=False), False),
        ([(50.2, 100, OFF), (100, 130, OFF), (130, 140, ON)], Onset(50.2, exact=False), False),
        ([(0, 99, ON)], Onset(100), True),
    ],
    ids=[
        "the change is there",
        "equal neighbours are one",
        "the last change counts",
        "the change is in a hole",
        "a long hole ends what is known",
        "a restart of twenty seconds is bridged",
        "nothing near the first sight",
        "it began before what is read",
        "nothing is stored",
        "what came later is left out",
        "it changed with the first sight",
    ],
)
def test_the_stored_bits_show_when_it_began(spans: list[WordSpan], onset: Onset, complete: bool) -> None:
    assert onset_in(spans, off, Onset(100, exact=False), SEEN) == (onset, complete)


def test_two_conditions_hold_together_since_the_later_of_them() -> None:
    assert later(Onset(1.0), Onset(2.0, exact=False)) == Onset(2.0, exact=False)
    assert later(Onset(1.0), None) is None


def test_an_onset_that_has_passed_is_not_corrected() -> None:
    onsets = Onsets()
    onsets.note(10.0, frozenset({"run_off"}), SEEN)
    seen = onsets.since["run_off"]
    assert onsets.correct("run_off", seen, Onset(5.0))
    assert onsets.since["run_off"] == Onset(5.0)
    assert not onsets.correct("run_off", seen, Onset(4.0))

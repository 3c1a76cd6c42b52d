"""At which baud rate a line without responses is polled."""

from __future__ import annotations

import pytest

from bus.line.poll_schedule import LOOK_ELSEWHERE_S, BaudSearch

LONG = LOOK_ELSEWHERE_S + 0.1


def expecting_4800() -> BaudSearch:
    rate = BaudSearch(0.0)
    rate.expect(4800, 9600)
    return rate


def at_4800() -> BaudSearch:
    """Return a search at the expected rate, after no response at 9600."""
    rate = expecting_4800()
    assert rate.turn(LONG, 9600, responds=False) == 4800
    rate.tuned(LONG)
    return rate


def test_without_an_expected_rate_a_line_without_responses_stays_at_its_rate() -> None:
    assert BaudSearch(0.0).turn(100.0, 9600, responds=False) is None


def test_a_line_without_responses_is_polled_at_both_rates_in_turn() -> None:
    assert expecting_4800().turn(LOOK_ELSEWHERE_S, 9600, responds=False) is None
    rate = at_4800()
    assert rate.turn(LONG + 0.1, 4800, responds=False) is None
    assert rate.turn(2 * LONG, 4800, responds=False) == 9600
    rate.tuned(2 * LONG)
    assert rate.turn(100.0, 9600, responds=True) is None, (
        "it was switched off, and is not at its new rate yet"
    )
    assert rate.turn(200.0, 9600, responds=False) == 4800


def test_a_response_at_the_expected_rate_ends_the_search() -> None:
    rate = expecting_4800()
    assert rate.turn(100.0, 9600, responds=True) is None, "some have not been switched off and on yet"
    assert rate.turn(100.0, 4800, responds=True) is None
    assert rate.turn(200.0, 4800, responds=False) is None


def test_nor_is_one_that_was_found_there_by_looking() -> None:
    rate = at_4800()
    assert rate.turn(LONG + 1, 4800, responds=True) is None
    assert rate.turn(200.0, 4800, responds=False) is None


def test_a_response_keeps_the_line_at_its_rate() -> None:
    rate = expecting_4800()
    assert rate.turn(LONG, 9600, responds=True) is None
    assert rate.turn(LONG, 9600, responds=False) == 4800


@pytest.mark.parametrize("present", [9600, 2400])
def test_a_change_that_left_every_unit_at_its_rate_ends_the_expectation(present: int) -> None:
    rate = expecting_4800()
    rate.expect(present, present)
    assert rate.turn(100.0, present, responds=False) is None

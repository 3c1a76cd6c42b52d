"""At which rate a silent line is asked."""

from __future__ import annotations

from bus.line.other_rate import LOOK_ELSEWHERE_S, OtherRate


def test_without_an_expectation_a_silent_line_stays_at_its_rate() -> None:
    rate = OtherRate(0.0)
    assert not rate.look(100.0, 9600, answers=False)
    assert rate.turn(9600) is None


def test_a_silent_line_is_asked_at_both_rates_in_turn() -> None:
    rate = OtherRate(0.0)
    rate.expect(4800)
    assert not rate.look(LOOK_ELSEWHERE_S, 9600, answers=False)
    assert rate.look(LOOK_ELSEWHERE_S + 0.1, 9600, answers=False)
    assert rate.turn(9600) == 4800
    rate.tuned(LOOK_ELSEWHERE_S + 0.1)
    assert rate.turn(4800) is None, "once for each look"
    assert not rate.look(LOOK_ELSEWHERE_S + 0.2, 4800, answers=False)
    assert rate.look(3 * LOOK_ELSEWHERE_S, 4800, answers=False)
    assert rate.turn(4800) == 9600


def test_a_line_that_answers_at_the_expected_rate_is_looked_for_no_more() -> None:
    rate = OtherRate(0.0)
    rate.expect(4800)
    assert not rate.look(100.0, 9600, answers=True), "some have not been switched off and on yet"
    assert not rate.look(100.0, 4800, answers=True)
    assert not rate.look(200.0, 4800, answers=False)

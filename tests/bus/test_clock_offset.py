"""A command that was held up is late, whatever else was held up with it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.contract.clock_offset import WINDOW_S, ClockOffset

PROMPT_S = 0.001


def send_each_second(clock: ClockOffset, since: float, until: float, ahead: float = 0.0) -> None:
    """Send the time of an app whose clock is ``ahead`` once a second, without delay."""
    now = since
    while now < until:
        clock.observe(now + ahead, now + PROMPT_S)
        now += 1.0


@given(st.floats(0.6, 300.0), st.floats(0.0, 1.0))
def test_a_stall_of_any_length_makes_no_deadline_later(stall_s: float, phase_s: float) -> None:
    clock, frozen_at = ClockOffset(), 100.0 + phase_s
    send_each_second(clock, 0.0, 100.0)
    thawed_at = frozen_at + stall_s
    sent_at = 101.0
    while sent_at < thawed_at:
        clock.observe(sent_at, thawed_at)
        sent_at += 1.0
    assert clock.here(frozen_at) <= frozen_at + 2 * PROMPT_S


def test_another_clock_is_reckoned_with() -> None:
    clock = ClockOffset()
    send_each_second(clock, 0.0, 5.0, ahead=3600.0)
    assert clock.here(3600.0) == pytest.approx(PROMPT_S)


def test_a_clock_set_ahead_is_followed_at_once_and_one_set_back_after_two_windows() -> None:
    clock = ClockOffset()
    send_each_second(clock, 0.0, 5.0)
    send_each_second(clock, 5.0, 6.0, ahead=60.0)
    assert clock.here(65.0) == pytest.approx(5.0 + PROMPT_S)
    send_each_second(clock, 6.0, 6.0 + 2 * WINDOW_S + 2)
    assert clock.here(30.0) == pytest.approx(30.0 + PROMPT_S)


def test_before_the_first_message_of_the_app_its_clock_is_ours() -> None:
    assert ClockOffset().here(5.0) == 5.0

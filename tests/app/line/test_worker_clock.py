"""The offset of a worker's clock, derived from its messages."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.feed.ingest import MAX_DELAY_S, SAME_CLOCK_S, WorkerClock, shifted
from bus.contract import Frame, Reading, Result, UnitOutcome
from bus.contract.session import WINDOW_S, ClockOffset
from bus.messages import term

DELAYS = st.lists(st.floats(0.0005, 5.0), min_size=1, max_size=50)


@given(st.floats(-1e6, 1e6), DELAYS)
def test_the_least_delay_is_nearest(offset_s: float, delays: list[float]) -> None:
    clock, now = WorkerClock(), 1000.0
    for delay in delays:
        clock.observe(now - delay - offset_s, now, now)
        now += 0.1
    assert abs(clock.offset_s - offset_s) <= min(delays) + SAME_CLOCK_S + 1e-6


@given(DELAYS, st.floats(0.0005, SAME_CLOCK_S / 2))
def test_one_clock_is_never_shifted_once_a_message_was_prompt(delays: list[float], prompt: float) -> None:
    clock, now = WorkerClock(), 1000.0
    for delay in [*delays[:5], prompt]:
        clock.observe(now - delay, now, now)
        now += 0.01
    assert clock.offset_s == 0.0


@given(DELAYS, DELAYS)
def test_one_clock_is_never_shifted_when_the_worker_states_its_side(
    there: list[float], back: list[float]
) -> None:
    """However late every message is, in both directions."""
    clock, now = WorkerClock(), 1000.0
    for delay, other in zip(there, back, strict=False):
        assert clock.observe(now - min(delay, MAX_DELAY_S - 0.001), now, now, other) == 0.0
        assert clock.offset_s == 0.0
        now += 0.1


@given(st.floats(-1e6, 1e6), DELAYS, DELAYS)
def test_another_clock_is_found_within_the_uncertainty(
    offset_s: float, there: list[float], back: list[float]
) -> None:
    clock, now = WorkerClock(), 1000.0
    for delay in there:
        clock.observe(now - delay - offset_s, now, now, min(back) - offset_s)
    assert abs(clock.offset_s - offset_s) <= min(there) + max(min(back), SAME_CLOCK_S) + 1e-6


@pytest.mark.parametrize("step", [3.0, -3.0, 3600.0, -3600.0])
def test_a_step_of_the_worker_s_clock_is_noticed_beside_a_stated_side(step: float) -> None:
    clock, seen, steps = WorkerClock(), ClockOffset(), []
    for tenth in range(600):
        now = 1000.0 + tenth / 10
        offset = 0.0 if tenth < 100 else step
        seen.observe(now - 0.001, now - offset)
        steps.append(clock.observe(now - 0.001 - offset, now, now, seen.seconds))
    assert [round(found) for found in steps if found] == [step]
    assert round(clock.offset_s) == step


@pytest.mark.parametrize("step", [2.0, -2.0, 3600.0, -3600.0])
def test_the_app_s_own_clock_is_no_step_of_a_worker_that_states_its_side(step: float) -> None:
    """The app sends its time once a second."""
    clock, seen = WorkerClock(), ClockOffset()
    for tenth in range(600):
        running = 1000.0 + tenth / 10
        now = running + (step if tenth >= 101 else 0.0)
        if not tenth % 10:
            seen.observe(now - 0.01, running - 7.0)
        assert clock.observe(running - 0.01 - 7.0, now, running, seen.seconds) == 0.0
        if tenth > 101:
            assert abs(clock.offset_s - (now - running + 7.0)) < SAME_CLOCK_S


def test_a_step_is_noticed_once_and_followed() -> None:
    clock, steps = WorkerClock(), []
    for tenth in range(600):
        now = 1000.0 + tenth / 10
        offset = 0.0 if tenth < 100 else 3600.0
        steps.append(clock.observe(now - 0.001 - offset, now, now))
    assert [round(step) for step in steps if step] == [3600]
    assert round(clock.offset_s) == 3600


def test_a_step_ahead_is_noticed_at_once() -> None:
    clock = WorkerClock()
    clock.observe(1000.0, 1000.001, 1000.001)
    assert round(clock.observe(1060.0, 1000.1, 1000.1)) == -60


@pytest.mark.parametrize("remote", [False, True], ids=["on the same machine", "on another"])
def test_the_app_s_own_clock_set_back_is_no_step_of_the_worker(remote: bool) -> None:
    """With a message on its way at that moment."""
    clock, steps = WorkerClock(), []
    offset = 7.0 if remote else 0.0
    for tenth in range(300):
        running = 1000.0 + tenth / 10
        now = running - (3600.0 if tenth >= 100 else 0.0)
        sent = running - 0.01 - offset - (3600.0 if not remote and tenth >= 101 else 0.0)
        steps.append(clock.observe(sent, now, running))
        if tenth >= 100:
            assert abs(clock.offset_s - (offset - (3600.0 if remote else 0.0))) < SAME_CLOCK_S
    assert set(steps) == {0.0}


def test_a_stall_is_no_step() -> None:
    clock = WorkerClock()
    clock.observe(999.999, 1000.0, 1000.0)
    for tenth in range(int(WINDOW_S * 5)):
        assert clock.observe(1000.0, 1000.0 + tenth / 10, 1000.0 + tenth / 10) == 0.0


def test_every_time_in_a_message_is_shifted_and_nothing_else() -> None:
    outcome = UnitOutcome(unit=1, outcome="verified", read_back=5, sent_at=1.0, proven_at=2.0)
    frame = Frame(at=1.0, direction="out", data=b"x", meanings=[term("")])
    result = Result(id="a", at=3.0, outcome="verified", units=[outcome], frames=[frame])
    moved = shifted(result, 10.0)
    assert (moved.at, moved.frames[0].at) == (13.0, 11.0)
    assert (moved.units[0].sent_at, moved.units[0].proven_at) == (11.0, 12.0)
    assert (moved.units[0].acknowledged_at, moved.units[0].read_back) == (None, 5)
    reading = Reading(unit=1, at=5.0, commanded=1, actual=2, analog=3, outputs=4, inputs=5)
    assert shifted(reading, 0.0) is reading

"""How much a worker may send, and the offset of its clock, derived from its messages."""

from __future__ import annotations

from itertools import repeat

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.feed.ingest import (
    MAX_AT_ONCE,
    MAX_BYTES_PER_S,
    MAX_DELAY_S,
    MAX_VALUES_AT_ONCE,
    MAX_VALUES_PER_S,
    PER_S,
    SAME_CLOCK_S,
    FeedQuota,
    WorkerClock,
    cost_of,
    shifted,
)
from bus.contract import (
    Batch,
    BusFigures,
    BusLink,
    Frame,
    Frames,
    Reading,
    Result,
    Snapshot,
    UnitFigures,
    UnitLink,
    UnitOutcome,
    Update,
    encode,
)
from bus.contract.session import WINDOW_S, ClockOffset
from bus.messages import term
from bus.worker.outbox import MAX_OTHERS, MAX_READINGS
from tests.app.fake_worker import unit_state

READING = Reading(1, 1.0, 0, 0, 0, 0, 0)


def test_a_full_bus_that_is_followed_never_waits() -> None:
    """38 readings a second, their frames, and the figures of 255 units."""
    quota = FeedQuota()
    figures = BusFigures(1.0, 1.0, 1.0, 1.0, 1.0, units=[UnitFigures(unit) for unit in range(1, 256)])
    frame = Frame(1.0, "in", b"", [])
    second: list[Update] = [READING] * 38 + [Frames([frame, frame])] * 38 + [figures]
    messages = [Batch(1, 1.0, [update]) for update in second]
    assert sum(map(cost_of, messages)) < PER_S / 5
    sizes = [len(encode(message)) for message in messages]
    assert sum(sizes) < MAX_BYTES_PER_S / 2
    for at in range(100):
        assert not any(map(quota.pause_s, messages, sizes, repeat(float(at))))
        assert all(quota.admits(READING, float(at)) for _ in range(38))


def test_a_complete_snapshot_and_a_full_buffer_come_at_once() -> None:
    quota = FeedQuota()
    state = unit_state(1, dict.fromkeys(range(1, 41), 0))
    complete = Snapshot(0, 1.0, BusLink(1.0, "open"), [state] * 255)
    assert quota.pause_s(complete, len(encode(complete)), 0.0) == 0.0
    late = Batch(1, 1.0, [READING] * 500, live=False)
    assert not any(quota.pause_s(late, len(encode(late)), 0.0) for _ in range(40_000 // 500 // 2))
    assert all(quota.admits(READING, 0.0) for _ in range(MAX_READINGS + MAX_OTHERS))


@pytest.mark.parametrize(
    "update",
    [READING, BusLink(1.0, "closed", "a cause"), UnitLink(1, 1.0, "offline", "a cause")],
    ids=["readings", "ports", "units"],
)
def test_a_flood_is_held_back(update: Update) -> None:
    """In a minute no more than what is let through at once, and a minute of the rate."""
    quota, at, taken = FeedQuota(), 0.0, 0
    batch = Batch(1, 1.0, [update] * 500)
    while at < 60.0:
        at += quota.pause_s(batch, 0, at)
        taken += 500
    assert taken <= MAX_AT_ONCE + 60 * PER_S + 500


def test_no_token_sends_ten_gigabytes_a_day() -> None:
    """Frames of the trace, which cost next to nothing else."""
    quota, at, taken, size = FeedQuota(), 0.0, 0, 1_000_000
    batch = Batch(1, 1.0, [Frames([Frame(1.0, "in", bytes(1024), [])] * 100)])
    while at < 86_400.0:
        at += quota.pause_s(batch, size, at)
        taken += size
    assert taken < 10_000_000_000


def test_more_values_than_a_wire_can_carry_are_refused() -> None:
    quota = FeedQuota()
    taken = sum(quota.admits(READING, tenth / 10) for tenth in range(600) for _ in range(200))
    assert taken == pytest.approx(MAX_VALUES_AT_ONCE + 60 * MAX_VALUES_PER_S, rel=0.001)


def test_states_with_their_causes_are_stored_more_seldom() -> None:
    """Each may bring 4 kB of text. All units of a bus may be lost and found, several times."""
    quota, link = FeedQuota(), UnitLink(1, 1.0, "offline", "a cause")
    assert sum(quota.admits(link, 0.0) for _ in range(5_000)) == 1_000
    assert quota.admits(BusFigures(1.0, 1.0, 1.0, 1.0, 1.0), 0.0), "it is not stored"


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


@pytest.mark.parametrize("step", [3.0, -3600.0])
def test_a_step_of_the_worker_s_clock_is_noticed_beside_a_stated_side(step: float) -> None:
    clock, seen, steps = WorkerClock(), ClockOffset(), []
    for tenth in range(600):
        now = 1000.0 + tenth / 10
        offset = 0.0 if tenth < 100 else step
        seen.observe(now - 0.001, now - offset)
        steps.append(clock.observe(now - 0.001 - offset, now, now, seen.seconds))
    assert [round(found) for found in steps if found] == [step]
    assert round(clock.offset_s) == step


@pytest.mark.parametrize("step", [2.0, -3600.0])
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

"""How much a worker may send: far more than any wire carries, and no more."""

from __future__ import annotations

from itertools import repeat

import pytest

from app.line.feed.ingest import (
    MAX_AT_ONCE,
    MAX_BYTES_PER_S,
    MAX_VALUES_AT_ONCE,
    MAX_VALUES_PER_S,
    PER_S,
    FeedQuota,
    cost_of,
)
from bus.contract import (
    Batch,
    BusFigures,
    BusLink,
    Frame,
    Frames,
    Reading,
    Snapshot,
    UnitFigures,
    UnitLink,
    Update,
    encode,
)
from bus.worker.outbox import MAX_OTHERS, MAX_READINGS
from tests.app.stage import hello, unit_state

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
    for at in range(1_000):
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
    taken = sum(quota.admits(READING, tenth / 10) for tenth in range(3_600) for _ in range(200))
    assert taken == pytest.approx(MAX_VALUES_AT_ONCE + 360 * MAX_VALUES_PER_S, rel=0.001)


def test_states_with_their_causes_are_stored_more_seldom() -> None:
    """Each may bring 4 kB of text. All units of a bus may be lost and found, several times."""
    quota, link = FeedQuota(), UnitLink(1, 1.0, "offline", "a cause")
    assert sum(quota.admits(link, 0.0) for _ in range(5_000)) == 1_000
    assert quota.admits(BusFigures(1.0, 1.0, 1.0, 1.0, 1.0), 0.0), "it is not stored"


def test_a_hello_costs_next_to_nothing() -> None:
    assert cost_of(hello()) == 1.0

"""How much a worker may send: far more than any wire carries, and no more."""

from __future__ import annotations

import pytest

from app.feed.rates import AT_ONCE, PER_S, cost_of, update_bucket
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
)
from tests.app.stage import hello, unit_state

READING = Reading(1, 1.0, 0, 0, 0, 0, 0)


def test_a_full_bus_that_is_followed_never_waits() -> None:
    """38 readings a second, their frames, and the figures of 255 units."""
    bucket = update_bucket()
    figures = BusFigures(1.0, 1.0, 1.0, 1.0, 1.0, units=[UnitFigures(unit) for unit in range(1, 256)])
    frame = Frame(1.0, "in", b"", [])
    second: list[Update] = [READING] * 38 + [Frames([frame, frame])] * 38 + [figures]
    cost = sum(cost_of(Batch(1, 1.0, [update])) for update in second)
    assert cost < PER_S / 5
    assert not any(bucket.pour(cost, float(at)) for at in range(10_000))


def test_a_complete_snapshot_and_a_full_buffer_come_at_once() -> None:
    bucket = update_bucket()
    state = unit_state(1, dict.fromkeys(range(1, 41), 0))
    assert bucket.pour(cost_of(Snapshot(0, 1.0, BusLink(1.0, "open"), [state] * 255)), 0.0) == 0.0
    late = Batch(1, 1.0, [READING] * 500, live=False)
    assert not any(bucket.pour(cost_of(late), 0.0) for _ in range(40_000 // 500 // 2))


@pytest.mark.parametrize(
    "update",
    [READING, BusLink(1.0, "closed", "a cause"), UnitLink(1, 1.0, "offline", "a cause")],
    ids=["readings", "ports", "units"],
)
def test_a_flood_is_held_back(update: Update) -> None:
    """In a minute no more than what is let through at once, and a minute of the rate."""
    bucket, at, taken = update_bucket(), 0.0, 0
    batch = Batch(1, 1.0, [update] * 500)
    while at < 60.0:
        at += bucket.pour(cost_of(batch), at)
        taken += 500
    assert taken <= AT_ONCE + 60 * PER_S + 500


def test_a_hello_costs_next_to_nothing() -> None:
    assert cost_of(hello()) == 1.0

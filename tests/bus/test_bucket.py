"""A leaky bucket: how often or how much of something is allowed."""

from __future__ import annotations

import pytest

from bus.bucket import Bucket


def test_it_is_used_up_and_comes_back() -> None:
    bucket = Bucket(per_s=2.0, capacity=3)
    assert [bucket.take(0.0) for _ in range(4)] == [True, True, True, False]
    assert [bucket.take(0.5) for _ in range(2)] == [True, False]
    assert [bucket.take(100.0) for _ in range(4)] == [True, True, True, False]


def test_an_amount_is_taken_as_one_or_not_at_all() -> None:
    bucket = Bucket(per_s=2.0, capacity=3)
    assert [bucket.take(0.0, 2), bucket.take(0.0, 2), bucket.take(0.0, 1)] == [True, False, True]
    assert bucket.wait_s(0.0, 2) == pytest.approx(1.0)


def test_a_clock_that_steps_back_costs_nothing() -> None:
    bucket = Bucket(per_s=2.0, capacity=3)
    assert all(bucket.take(100.0) for _ in range(3))
    assert [bucket.take(at) for at in (0.0, 0.4, 0.5)] == [False, False, True]


def test_an_amount_over_the_capacity_returns_the_time_to_wait() -> None:
    bucket = Bucket(per_s=10.0, capacity=100.0)
    assert bucket.pour(100.0, 0.0) == 0.0
    assert bucket.pour(5.0, 0.0) == pytest.approx(0.5)
    assert bucket.wait_s(0.0) == pytest.approx(0.6)
    assert bucket.pour(0.0, 0.5) == 0.0
    assert bucket.pour(100.0, 1e9) == 0.0, "what was not used does not add up"


def test_removed_amounts_leave_room_up_to_the_capacity() -> None:
    bucket = Bucket(per_s=1.0, capacity=1)
    bucket.fill(0.0)
    assert not bucket.has_room(0.0)
    bucket.pour(-5.0, 0.0)
    assert [bucket.take(0.0) for _ in range(2)] == [True, False]

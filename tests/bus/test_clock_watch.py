"""A clock that was set is noticed; one that is corrected slowly is not."""

from __future__ import annotations

import pytest

from bus.instants import ClockWatch


def test_a_running_clock_has_no_step() -> None:
    watch = ClockWatch(1000.0, 5.0)
    assert [watch.step(1000.0 + i, 5.0 + i) for i in range(1, 5)] == [0.0] * 4


@pytest.mark.parametrize("step", [-3600.0, 3600.0, 1.5, -1.0])
def test_a_step_is_reported_once_with_its_size(step: float) -> None:
    watch = ClockWatch(1000.0, 5.0)
    assert watch.step(1001.0 + step, 6.0) == pytest.approx(step)
    assert watch.step(1002.0 + step, 7.0) == 0.0


def test_a_slow_correction_is_none() -> None:
    watch = ClockWatch(0.0, 0.0)
    assert all(watch.step(i * 1.01, float(i)) == 0.0 for i in range(1000))

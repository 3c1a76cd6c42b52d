"""Moments and durations are never each other for the type checker; a clock that was set is noticed."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest
from pydantic import TypeAdapter

from bus.instants import Clock, ClockWatch, Monotonic, MonotonicClock, UnixTime, monotonic_now, unix_now


def told_apart(wait: Callable[[float], None], send_by: Callable[[Monotonic], None], wall: Clock) -> None:
    """What the type checker permits, then what it refuses: ``make check`` fails where an error that is
    ignored here is none. Nothing calls this.
    """
    running: MonotonicClock = monotonic_now
    wait(unix_now() - UnixTime(0) + 1)
    wait(float(unix_now()))
    send_by(max(running() + 2.0, monotonic_now() - 2))
    at: UnixTime = wall()
    wait(at)  # type: ignore[arg-type]
    send_by(2.0)  # type: ignore[arg-type]
    send_by(unix_now())  # type: ignore[arg-type]
    at = 2  # type: ignore[assignment]
    at = monotonic_now()  # type: ignore[assignment]
    at = unix_now() - UnixTime(0)  # type: ignore[assignment]
    wait(unix_now() - 1.0)  # type: ignore[arg-type]
    print(unix_now() - monotonic_now())  # type: ignore[operator]
    print(unix_now() + unix_now())  # type: ignore[operator]
    print(unix_now() < monotonic_now())  # type: ignore[operator]
    print(unix_now() > 1.0)  # type: ignore[operator]
    print(unix_now() == 1.0)  # type: ignore[comparison-overlap]
    wall = monotonic_now  # type: ignore[assignment]


def test_they_are_floats_at_run_time() -> None:
    assert isinstance(unix_now(), float)
    assert isinstance(monotonic_now(), float)
    for read in (msgspec.json.decode(b"1.5", type=UnixTime), TypeAdapter(Monotonic).validate_json("1.5")):
        assert float(read) == 1.5
    assert TypeAdapter(UnixTime).json_schema() == {"type": "number"}


def steps(*moments: tuple[float, float]) -> list[float]:
    """What a watch that begins with the first of these times of both clocks finds at each other."""
    (wall, running), *later = moments
    watch = ClockWatch(UnixTime(wall), Monotonic(running))
    return [watch.step(UnixTime(wall), Monotonic(running)) for wall, running in later]


def test_a_running_clock_has_no_step() -> None:
    assert steps(*((1000.0 + i, 5.0 + i) for i in range(5))) == [0.0] * 4


@pytest.mark.parametrize("step", [-3600.0, 3600.0, 1.5, -1.0])
def test_a_step_is_reported_once_with_its_size(step: float) -> None:
    found = steps((1000.0, 5.0), (1001.0 + step, 6.0), (1002.0 + step, 7.0))
    assert found == [pytest.approx(step), 0.0]


def test_a_slow_correction_is_none() -> None:
    assert not any(steps(*((i * 1.01, float(i)) for i in range(1000))))

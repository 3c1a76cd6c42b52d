"""Moments and durations are never each other for the type checker; a clock that was set is noticed."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from mypy import api
from pydantic import TypeAdapter

from bus.instants import ClockWatch, Monotonic, UnixTime, monotonic_now, unix_now

RIGHT = """
from bus.instants import Clock, Monotonic, MonotonicClock, UnixTime, monotonic_now, unix_now

def wait(duration_s: float) -> None: ...
def send_by(deadline: Monotonic) -> None: ...
def record(at: UnixTime) -> None: ...

wall: Clock = unix_now
running: MonotonicClock = monotonic_now
wait(unix_now() - UnixTime(0) + 1)
wait(float(unix_now()))
send_by(max(monotonic_now() + 2.0, monotonic_now() - 2))
record(unix_now())
"""
WRONG = (
    "wait(unix_now())",
    "send_by(2.0)",
    "record(2)",
    "record(monotonic_now())",
    "send_by(unix_now())",
    "record(unix_now() - UnixTime(0))",
    "wait(unix_now() - 1.0)",
    "unix_now() - monotonic_now()",
    "unix_now() + unix_now()",
    "unix_now() < monotonic_now()",
    "unix_now() > 1.0",
    "unix_now() == 1.0",
    "wall = monotonic_now",
)


def test_mypy_refuses_one_for_the_other(tmp_path: Path) -> None:
    snippet = tmp_path / "snippet.py"
    snippet.write_text(RIGHT + "\n".join(WRONG))
    report, errors, _ = api.run(
        ["--strict", "--config-file=", f"--cache-dir={tmp_path}", "--no-error-summary", str(snippet)]
    )
    first = RIGHT.count("\n") + 1
    refused = {int(line.split(":")[1]) for line in report.splitlines() if ": error: " in line}
    assert not errors
    assert refused == set(range(first, first + len(WRONG))), report


def test_they_are_floats_at_run_time() -> None:
    assert isinstance(unix_now(), float)
    assert isinstance(monotonic_now(), float)
    assert msgspec.json.decode(b"1.5", type=UnixTime) == TypeAdapter(Monotonic).validate_json("1.5") == 1.5
    assert TypeAdapter(UnixTime).json_schema() == {"type": "number"}


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

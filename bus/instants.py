"""Moments on the two clocks, as types that differ from each other and from durations.

A moment and a duration are both floats at run time, and one in the place of the other is a command that acts
an hour late or never. For mypy a moment is no float: a duration added to it gives a moment, the difference of
two is a duration. ``float(moment)`` is the number for a library that wants one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Any, Self, overload

    class _Instant:
        def __new__(cls, seconds: float) -> Self: ...
        def __add__(self, duration: float) -> Self: ...
        @overload
        def __sub__(self, other: Self) -> float: ...
        @overload
        def __sub__(self, other: float) -> Self: ...
        def __sub__(self, other: Any) -> Any: ...
        def __lt__(self, other: Self) -> bool: ...
        def __le__(self, other: Self) -> bool: ...
        def __gt__(self, other: Self) -> bool: ...
        def __ge__(self, other: Self) -> bool: ...
        def __float__(self) -> float: ...
        def __round__(self, digits: int) -> Self: ...

    class UnixTime(_Instant):
        """A moment on the wall clock: seconds since 1970, UTC."""

    class Monotonic(_Instant):
        """A moment on the clock of this machine that is never set: seconds since an unknown one."""

    def unix_now() -> UnixTime: ...
    def monotonic_now() -> Monotonic: ...
else:
    UnixTime = Monotonic = float
    unix_now, monotonic_now = time.time, time.monotonic

Clock = Callable[[], UnixTime]
MonotonicClock = Callable[[], Monotonic]

HOUR_S, DAY_S = 3600.0, 86_400.0
MIN_STEP_S = 1.0


class ClockWatch:
    """A watch that detects when the wall clock was set, by comparing it with the monotonic clock. A slow
    correction is no step."""

    def __init__(self, wall: UnixTime, running: Monotonic) -> None:
        self._difference = float(wall) - float(running)

    def step(self, wall: UnixTime, running: Monotonic) -> float:
        """Return the seconds by which the wall clock was set since the last call; 0.0 if it was not."""
        before, self._difference = self._difference, float(wall) - float(running)
        moved = self._difference - before
        return moved if abs(moved) >= MIN_STEP_S else 0.0

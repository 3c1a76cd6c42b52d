"""The two clocks of a line and its one alarm: injected, so that tests run on a virtual one."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from typing import Protocol

from bus.instants import Monotonic, UnixTime, monotonic_now

SLEW_S = 0.001
"""How far the wall clock's drift is followed in one ``settle``; a step of more than a second at once."""
STEP_S = 1.0
NEVER = Monotonic(math.inf)


class Timer(Protocol):
    """A call to come."""

    def cancel(self) -> None:
        """Withdraw the call."""


class LineClock(Protocol):
    """``now`` never goes back; ``epoch`` is what other machines understand. Both in seconds."""

    def now(self) -> Monotonic:
        """Return the line's own time."""

    def epoch(self, now: Monotonic) -> UnixTime:
        """Return the moment ``now`` in seconds since 1970."""

    def settle(self) -> None:
        """Follow the wall clock a little; called about once a second."""

    def call_at(self, when: Monotonic, callback: Callable[[], None]) -> Timer:
        """Have ``callback`` run at ``when`` (of ``now``), or as soon as possible after."""


class RealClock:
    """The machine's clocks, a fixed offset apart: frames stay in order when the wall clock is set."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._offset = time.time() - time.monotonic()

    def now(self) -> Monotonic:
        return monotonic_now()

    def epoch(self, now: Monotonic) -> UnixTime:
        return UnixTime(float(now) + self._offset)

    def settle(self) -> None:
        error = time.time() - time.monotonic() - self._offset
        self._offset += error if abs(error) > STEP_S else max(-SLEW_S, min(SLEW_S, error))

    def call_at(self, when: Monotonic, callback: Callable[[], None]) -> Timer:
        return self._loop.call_later(max(0.0, when - self.now()), callback)

"""Until when this process may use its port. Pure: the clock is passed in.

A worker whose server has the home of its bus on a lease loses its port with that: its server may stand
still, or have no database, and another server takes the bus. The time counts from the request of the worker,
on a clock that counts on while the machine sleeps; a response that was held up extends nothing.
"""

from __future__ import annotations

import math
import time

from bus.instants import Monotonic, MonotonicClock
from bus.messages import Message

NOT_CONFIRMED = Message("port_not_confirmed")


def suspended_too() -> Monotonic:
    """The monotonic clock that counts on while the machine is suspended, where there is one."""
    return Monotonic(time.clock_gettime(_CLOCK))


_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)


class PortLease:
    """``is_needed`` False: the port belongs to this process alone, for good."""

    def __init__(self, *, is_needed: bool = False, clock: MonotonicClock = suspended_too) -> None:
        self.is_needed = is_needed
        self.clock = clock
        self._until = Monotonic(-math.inf if is_needed else math.inf)

    def holds(self) -> bool:
        """Whether the port may be used at this moment."""
        return not self.is_needed or self.clock() < self._until

    def left_s(self) -> float:
        """For how many seconds it may; 0 or less: it may not."""
        return self._until - self.clock() if self.is_needed else math.inf

    def extend(self, requested_at: Monotonic, left_s: float) -> None:
        """The server confirmed, for ``left_s`` from the request; or, with 0, ended it."""
        if self.is_needed:
            self._until = requested_at + left_s if left_s > 0 else Monotonic(-math.inf)


NO_LEASE = PortLease()

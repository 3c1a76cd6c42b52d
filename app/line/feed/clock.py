"""The offset of a worker's clock from the app's, from messages with their time of sending. Pure.

A message arrives late by as much as its way and a busy server take, and a clock judged by one direction
alone is wrong by that much. So the worker states how prompt the app's messages were for it: the true offset
is between the two (RFC 5905, 8).

A message in transit while the app's clock was set back seems to have arrived long before it was sent. After a
step of the app's clock nothing is judged until such messages are in.
"""

from __future__ import annotations

from math import inf
from typing import TypeVar

import msgspec

from bus.contract import TaggedStruct
from bus.contract.session import ClockOffset
from bus.instants import ClockWatch, Monotonic, UnixTime

SAME_CLOCK_S = 0.05
"""Clocks this near are one clock: most workers run on the app's own machine."""
MAX_DELAY_S = 5.0
"""A message that seems to be later than this shows another clock."""
STEP_S = 0.5
SETTLED_S = 2.5
"""How long after a step of the app's own clock a message may still have been on its way, or its worker not
have the time since, which is sent once a second."""

M = TypeVar("M", bound=TaggedStruct)

_TIMES = ("at", "sent_at", "acknowledged_at", "proven_at")


class WorkerClock:
    """What to add to one worker's times, in seconds."""

    def __init__(self) -> None:
        self.offset_s = 0.0
        self._difference = ClockOffset()
        self._own: ClockWatch | None = None
        self._settled_at = Monotonic(-inf)

    def observe(
        self,
        sent_at: UnixTime,
        received_at: UnixTime,
        running: Monotonic,
        app_behind_s: float | None = None,
    ) -> float:
        """Take in one message; gives by how much a *known* clock has stepped, mostly 0.0. ``running``: when
        it was received by a clock that cannot be set. ``app_behind_s``: see Snapshot."""
        if self._own_stepped(received_at, running):
            return 0.0
        first = self._difference.seconds is None
        self._difference.observe(sent_at, received_at)
        difference = self._difference.seconds or 0.0
        return self._settle(0.0 if _is_one_clock(difference, app_behind_s) else difference, first)

    def _own_stepped(self, received_at: UnixTime, running: Monotonic) -> bool:
        """Whether this is too soon after a step of the app's clock. A worker of another machine is off by
        that step now; one of this machine has made it too."""
        self._own = self._own or ClockWatch(received_at, running)
        step = self._own.step(received_at, running)
        if step:
            self._difference = ClockOffset()
            self._settled_at = running + SETTLED_S
            if self.offset_s:
                self.offset_s += step
        return running < self._settled_at

    def _settle(self, wanted: float, first: bool) -> float:
        change = wanted - self.offset_s
        if abs(change) < SAME_CLOCK_S and wanted != 0.0:
            return 0.0
        self.offset_s = wanted
        return change if abs(change) >= STEP_S and not first else 0.0


def _is_one_clock(difference: float, app_behind_s: float | None) -> bool:
    """Whether messages that were only late, in either direction, would differ as much."""
    if app_behind_s is None or app_behind_s <= -SAME_CLOCK_S:
        return abs(difference) < SAME_CLOCK_S
    return -SAME_CLOCK_S < difference < MAX_DELAY_S


def shifted(message: M, offset_s: float) -> M:
    """The same message, and all its parts, with every time moved by ``offset_s``."""
    if offset_s == 0.0:
        return message
    changed: dict[str, object] = {}
    for name in message.__struct_fields__:
        value = getattr(message, name)
        if name in _TIMES and value is not None:
            changed[name] = value + offset_s
        elif isinstance(value, TaggedStruct):
            changed[name] = shifted(value, offset_s)
        elif isinstance(value, list) and value and isinstance(value[0], TaggedStruct):
            changed[name] = [shifted(part, offset_s) for part in value]
    return msgspec.structs.replace(message, **changed)

"""When a unit without responses is probed: offline units may use only a share of the wire. Pure."""

from __future__ import annotations

import random
from dataclasses import dataclass

from bus.instants import Monotonic


class WireShare:
    """Limits a use of the wire to at most ``fraction`` of the time, however long one use is.

    Unused time can be saved up for ``burst_s`` seconds of waiting, so that short uses between long ones of
    others still reach the complete fraction. Pure: ``now`` in seconds is passed in.
    """

    def __init__(self, fraction: float, burst_s: float = 0.0) -> None:
        self.fraction = fraction
        self.burst_s = burst_s
        self.ready_at = Monotonic(float("-inf"))
        """The moment from which it may be used."""

    def ready(self, now: Monotonic) -> bool:
        return now >= self.ready_at

    def spend(self, now: Monotonic, seconds: float) -> None:
        """Note that the wire was used for ``seconds``, beginning at ``now``."""
        self.ready_at = max(self.ready_at, now - self.burst_s) + seconds / self.fraction


STEPS_S = (0.5, 1.0, 2.0, 4.0, 8.0, 10.0)
"""Back-off after each probe without a response."""
ALONE_STEP_S = 1.0
"""The longest back-off while no unit responds: no other unit is delayed."""
JITTER = 0.2
"""A step is shortened by up to this part, so that units lost together do not stay in step."""
WIRE_SHARE = 0.05
"""The part of the wire for probes of all units without responses."""
WIRE_SHARE_ALONE = 0.5
"""The same while no unit responds: a line that is switched on again is found at once."""


@dataclass(slots=True)
class _OfflineUnit:
    step: int
    due: Monotonic


class ProbeBackoff:
    """The units that do not respond, and when each is probed next.

    One probe costs one timeout; the timeouts of all are rationed to ``WIRE_SHARE``. A probe with a response
    costs nothing, so a complete line that comes back is found as fast as it responds.
    """

    def __init__(self, seed: int = 0) -> None:
        self._units: dict[int, _OfflineUnit] = {}
        self._rations = _rations()
        self._random = random.Random(seed)
        self.alone = True
        """Whether no unit responds; set by the schedule."""

    def __len__(self) -> int:
        return len(self._units)

    def __contains__(self, unit: int) -> bool:
        return unit in self._units

    def stopped_responding(self, unit: int, now: Monotonic) -> None:
        """``unit`` stopped responding, or did not respond to its first request."""
        self._units[unit] = _OfflineUnit(0, now + self._wait(0))

    def no_response(self, unit: int, now: Monotonic, cost_s: float) -> None:
        """A probe of ``unit`` cost a timeout of ``cost_s`` seconds that ended at ``now``."""
        self._rations[self.alone].spend(now, cost_s)
        offline = self._units.get(unit)
        if offline is not None:
            offline.step = min(offline.step + 1, len(STEPS_S) - 1)
            offline.due = now + self._wait(offline.step)

    def responded(self, unit: int, now: Monotonic) -> None:
        """``unit`` responds again; others may have had the same cause, so they are due now."""
        if self._units.pop(unit, None) is not None:
            for other in self._units.values():
                other.due = min(other.due, now)

    def forgive(self, now: Monotonic) -> None:
        """Every unit is due at once, the longest waiting first, the first whatever was spent before."""
        self._rations = _rations()
        for offline in self._units.values():
            offline.step, offline.due = 0, min(offline.due, now)

    def due(self, now: Monotonic) -> int | None:
        """The unit to probe now, the longest overdue first; None when none is due or the ration is used."""
        if not self._units or not self._rations[self.alone].ready(now):
            return None
        unit = min(self._units, key=lambda each: self._due_of(self._units[each]))
        return unit if self._due_of(self._units[unit]) <= now else None

    def wake_at(self) -> Monotonic | None:
        """Return when the next probe may leave; None when all units respond."""
        if not self._units:
            return None
        first_due = min(self._due_of(offline) for offline in self._units.values())
        return max(self._rations[self.alone].ready_at, first_due)

    def _wait(self, step: int) -> float:
        return STEPS_S[step] * (1.0 - JITTER * self._random.random())

    def _due_of(self, offline: _OfflineUnit) -> Monotonic:
        if not self.alone:
            return offline.due
        late = max(0.0, STEPS_S[offline.step] - ALONE_STEP_S)
        return offline.due - late


def _rations() -> dict[bool, WireShare]:
    """Return the ration of probes, which is larger while no unit responds."""
    return {False: WireShare(WIRE_SHARE), True: WireShare(WIRE_SHARE_ALONE)}

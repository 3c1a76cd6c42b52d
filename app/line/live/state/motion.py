"""Whether a unit is at speed, ramping, or neither. Pure: readings in, state out.

The unit itself reports only *at speed* (ST2 bit 7). The rest follows from the readings: a unit whose distance
from its target shrinks is ramping; one whose distance has not shrunk for a while is off speed.
Without run, or with an emergency stop active, its target is standstill, whatever is commanded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.line.live.state.conditions import is_driven
from bus.catalogue.status import StatusBits
from bus.contract import Reading
from bus.instants import UnixTime

MotionState = Literal[
    "", "at_speed", "at_zero", "ramping_up", "ramping_down", "off_speed", "stopped", "stopping", "turning"
]
"""``stopped``, ``stopping``, ``turning``: not driven; standing still, slowing down, or neither."""

PATIENCE_S = 3.0
"""A unit that has come no nearer for this long, or for three scans, is not ramping any more."""
PATIENCE_SCANS = 3


@dataclass(slots=True)
class Motion:
    """The way of one unit towards its commanded speed, or to a standstill."""

    state: MotionState = ""
    _goal: int | None = None
    _least_error: int = 0
    _nearer_at: UnixTime = UnixTime(0.0)

    def see(self, reading: Reading, bits: StatusBits, *, scan_s: float, ratio: bool = False) -> MotionState:
        """The state after this reading. ``ratio``: its speeds are ratios to a master, which do not show
        whether the motor turns."""
        if reading.commanded is None or reading.actual is None:
            self.state, self._goal = "", None
            return self.state
        driven = is_driven(bits)
        goal = reading.commanded if driven else 0
        error = abs(goal - reading.actual)
        arrived = bits.at_speed if driven else error == 0
        if goal != self._goal or error < self._least_error or arrived:
            self._goal, self._least_error, self._nearer_at = goal, error, reading.at
        gave_up = reading.at - self._nearer_at > max(PATIENCE_S, PATIENCE_SCANS * scan_s)
        if driven or (reading.commanded == 0 and reading.actual == 0):
            self.state = _driven(reading.commanded, reading.actual, bits.at_speed, gave_up)
        else:
            self.state = "" if ratio else _not_driven(reading, gave_up)
        return self.state


def _driven(commanded: int, actual: int, at_speed: bool, gave_up: bool) -> MotionState:
    if commanded == 0 and actual == 0:
        return "at_zero"
    if at_speed:
        return "at_speed"
    if gave_up:
        return "off_speed"
    return "ramping_up" if commanded > actual else "ramping_down"


def _not_driven(reading: Reading, gave_up: bool) -> MotionState:
    if reading.actual == 0:
        return "stopped"
    return "turning" if gave_up else "stopping"

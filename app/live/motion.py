"""Whether a unit is at speed, on its way there, or neither. Pure: readings in, one word out.

The unit itself says only *at speed* (ST2 bit 7). What lies between is told from the readings: a
unit whose error shrinks is ramping; one whose error has not shrunk for a while is off speed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from bus.contract import Reading

State = Literal["", "at_speed", "at_zero", "ramping_up", "ramping_down", "off_speed"]

PATIENCE_S = 3.0
"""A unit that has come no nearer for this long, or for three scans, is not ramping any more."""
PATIENCE_SCANS = 3


@dataclass(slots=True)
class Motion:
    """The way of one unit towards its commanded speed."""

    state: State = ""
    _commanded: int | None = None
    _least_error: int = 0
    _nearer_at: float = 0.0
    since: dict[str, float] = field(default_factory=dict)
    """When a condition began, as far as it was seen to begin; one that held from the first is not in it."""
    _held: frozenset[str] | None = None

    def see(self, reading: Reading, *, at_speed: bool, scan_s: float) -> State:
        """The state after this reading."""
        error = abs(reading.commanded - reading.actual)
        if reading.commanded != self._commanded:
            self._commanded, self._least_error, self._nearer_at = reading.commanded, error, reading.at
        elif error < self._least_error or at_speed:
            self._least_error, self._nearer_at = error, reading.at
        patience = max(PATIENCE_S, PATIENCE_SCANS * scan_s)
        self.state = self._judge(reading, at_speed, reading.at - self._nearer_at > patience)
        return self.state

    def note(self, at: float, conditions: frozenset[str]) -> None:
        """Which conditions hold, by a reading at ``at``."""
        if conditions == self._held:
            return
        begun = conditions - self._held if self._held is not None else frozenset()
        self.since = {name: began for name, began in self.since.items() if name in conditions}
        self.since |= dict.fromkeys(begun, at)
        self._held = conditions

    def _judge(self, reading: Reading, at_speed: bool, gave_up: bool) -> State:
        if reading.commanded == 0 and reading.actual == 0:
            return "at_zero"
        if at_speed:
            return "at_speed"
        if gave_up:
            return "off_speed"
        return "ramping_up" if reading.commanded > reading.actual else "ramping_down"

"""The machine behind one unit: motor, encoder and web, stepped with a given dt; same seed, same speeds.

The reference moves by the ramps #6 and #7 (time for the full span, manual 4.0); the motor follows it with a
short lag and a little jitter. A master's reference is its unit's commanded speed; a follower's is the
master's pulses times its ratio.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field

from bus.catalogue import parameters as numbers
from bus.simulator.unit import Unit
from bus.wire.commands import LARGEST_VALUE

RATIO_ONE = 10000
"""A ratio of 1.0000: four implied decimals (#4, #31, #37, #38)."""
INVERSE_FOLLOWER = 2
"""#8 of a unit that slows down as its master speeds up."""

MOTOR_LAG_S = 0.15
COAST_LAG_S = 2.5
ESTOP_LAG_S = 0.25
TENSION_LAG_S = 0.4
UNREST = 0.0002
"""Standard deviation of the speed, as a part of full speed."""
UNREST_LAG_S = 0.5
STANDSTILL = 0.0005
TENSION_AT_REST = 20.0
TENSION_RUNNING = 128.0
TENSION_PER_DRAW = 4000.0
"""ATD counts by which a web of one full-speed length would tighten: 1 % of draw is 40 counts."""


@dataclass
class Section:
    """A unit and its motor. Speeds here are parts of the unit's own full speed #1, signed by direction."""

    unit: Unit
    seed: int = 0
    unrest: bool = True
    """Whether speed and tension move a little, as those of a real machine do."""
    speed: float = 0.0
    reference: float = 0.0
    _unrest: float = 0.0
    _tension: float = TENSION_AT_REST
    _random: random.Random = field(init=False)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def settle(self, master_rpm: float = 0.0) -> None:
        """Start in steady state, at the commanded speed."""
        self.speed = self.reference = self._wanted(master_rpm)
        self._show(master_rpm)

    @property
    def rpm(self) -> float:
        """Motor speed, signed."""
        return self.speed * self.unit.memory[numbers.MAX_RPM]

    def step(self, dt: float, master_rpm: float, upstream: Section | None) -> None:
        """``dt`` seconds pass, with the master at ``master_rpm`` and the web coming from ``upstream``."""
        self._ramp(dt, self._wanted(master_rpm))
        self._turn(dt)
        self._pull(dt, upstream)
        self._show(master_rpm)

    def _wanted(self, master_rpm: float) -> float:
        unit = self.unit
        if not unit.running:
            return 0.0
        direction = -1.0 if unit.inputs.reverse else 1.0
        if unit.follows:
            return direction * min(self._following(master_rpm), 1.0)
        return direction * min(unit.commanded / max(unit.memory[numbers.MAX_DISPLAY], 1), 1.0)

    def _following(self, master_rpm: float) -> float:
        memory = self.unit.memory
        ratio = self.unit.commanded / RATIO_ONE
        if memory[numbers.FOLLOWER_MODE] == INVERSE_FOLLOWER:
            ratio = 1 / ratio if ratio else 0.0
        base = memory[numbers.BASE_RATIO] / RATIO_ONE
        return abs(master_rpm) * base * ratio / max(memory[numbers.MAX_RPM], 1)

    def _ramp(self, dt: float, wanted: float) -> None:
        if not self.unit.running:
            self.reference = self.speed
            return
        faster = abs(wanted) > abs(self.reference) and wanted * self.reference >= 0
        tenths = self.unit.memory[numbers.ACCELERATION if faster else numbers.DECELERATION]
        most = dt * 10 / tenths if tenths else math.inf
        self.reference += min(max(wanted - self.reference, -most), most)

    def _turn(self, dt: float) -> None:
        lag, goal = MOTOR_LAG_S, self.reference
        if self.unit.inputs.estop:
            lag, goal = ESTOP_LAG_S, 0.0
        elif not self.unit.inputs.run:
            lag, goal = COAST_LAG_S, 0.0
        self.speed += (goal - self.speed) * -math.expm1(-dt / lag)
        if goal == 0.0 and abs(self.speed) < STANDSTILL:
            self.speed = 0.0
        if not self.unrest:
            return
        fade = math.exp(-dt / UNREST_LAG_S)
        self._unrest = self._unrest * fade + UNREST * math.sqrt(1 - fade * fade) * self._random.gauss(0, 1)

    def _pull(self, dt: float, upstream: Section | None) -> None:
        """The web's tension, on the analog input: taut where this section runs faster than the one before."""
        draw = abs(self.speed) - abs(upstream.speed) if upstream else 0.0
        goal = TENSION_RUNNING if self.speed else TENSION_AT_REST
        goal = min(max(goal + draw * TENSION_PER_DRAW, 0.0), 255.0)
        self._tension += (goal - self._tension) * -math.expm1(-dt / TENSION_LAG_S)

    def _show(self, master_rpm: float) -> None:
        unit, measured = self.unit, self.unit.measured
        full = unit.memory[numbers.MAX_DISPLAY]
        unrest = self._unrest if self.speed else 0.0
        measured.actual = min(round(abs(self.speed + unrest) * full), LARGEST_VALUE)
        rattle = self._random.gauss(0, 0.6) if self.unrest else 0.0
        measured.analog = min(max(round(self._tension + rattle), 0), 255)
        if not unit.follows:
            return
        following = self._following(master_rpm)
        measured.following = min(round(following * full), LARGEST_VALUE)
        reached = unit.commanded * abs(self.speed) / following if following else 0.0
        measured.ratio = min(round(reached), LARGEST_VALUE)

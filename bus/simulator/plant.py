"""The machine behind the units: motors, encoders and web in floor order, and a demonstration line. No clock.

The same seed gives the same speeds. The reference of a section moves by the ramps #6 and #7 (time for the
full span, manual 4.0); its motor follows it with a short lag and a little jitter. A master's reference is its
unit's commanded speed; a follower's is the master's pulses times its ratio.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from bus.catalogue import parameters as numbers
from bus.settings import UnitLabels, UnitSettings
from bus.simulator.unit import ORDINARY, Memory, Traits, Unit
from bus.wire.commands import LARGEST_VALUE

RATIO_ONE = 10000
"""A ratio of 1.0000: four implied decimals (#4, #31, #37, #38)."""
INVERSE_FOLLOWER = 2
"""The value of #8 of a unit that slows down as its master speeds up."""

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
    """A unit and its motor. Speeds are signed parts of the unit's own full speed #1."""

    unit: Unit
    seed: int = 0
    unrest: bool = True
    """Whether speed and tension fluctuate a little, as those of a real machine do."""
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
        """Motor speed in rpm, signed."""
        return self.speed * self.unit.memory[numbers.MAX_RPM]

    def step(self, dt: float, master_rpm: float, upstream: Section | None) -> None:
        """Simulate ``dt`` seconds, with the master at ``master_rpm`` and the web coming from ``upstream``."""
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
        """Update the web's tension, on the analog input: taut if this section runs faster than the one
        before."""
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


STEP_S = 0.05
"""The step of the physics, in seconds."""

Contact = Literal["run", "estop", "preset", "reverse", "up", "down"]


@dataclass(frozen=True, slots=True)
class Habit:
    """The average pause between closings of a contact of some section, and their length, in seconds."""

    contact: Contact
    value: bool
    every_s: float
    hold_s: float


DEMO_HABITS: tuple[Habit, ...] = (
    Habit("up", True, every_s=47, hold_s=3),
    Habit("down", True, every_s=61, hold_s=3),
    Habit("estop", True, every_s=240, hold_s=20),
    Habit("run", False, every_s=420, hold_s=15),
    Habit("preset", True, every_s=540, hold_s=10),
)
"""Habits so rare that the line is mostly well: an operator taps a jog, and now and then something happens."""


class Script:
    """A script that operates one contact of one section at a time for each habit; unit and time come from the
    seed."""

    def __init__(self, units: Sequence[Unit], habits: Sequence[Habit] = DEMO_HABITS, seed: int = 0) -> None:
        self._units = units
        self._random = random.Random(seed)
        self._waiting = [(habit, self._pause(habit)) for habit in habits]
        self._held: list[tuple[Unit, Habit, float]] = []

    def step(self, dt: float) -> None:
        self._release(dt)
        for place, (habit, left) in enumerate(self._waiting):
            self._waiting[place] = (habit, left - dt)
            if left <= dt:
                self._press(habit)
                self._waiting[place] = (habit, self._pause(habit))

    def _pause(self, habit: Habit) -> float:
        return habit.every_s * self._random.uniform(0.8, 1.2)

    def _press(self, habit: Habit) -> None:
        unit = self._random.choice(self._units)
        if all(unit is not held for held, _, _ in self._held):
            setattr(unit.inputs, habit.contact, habit.value)
            self._held.append((unit, habit, habit.hold_s))

    def _release(self, dt: float) -> None:
        for unit, habit, left in self._held:
            if left <= dt:
                setattr(unit.inputs, habit.contact, not habit.value)
        self._held = [(unit, habit, left - dt) for unit, habit, left in self._held if left > dt]


class Plant:
    """The sections; the first that is no follower is the master whose pulses the followers count."""

    def __init__(self, sections: Sequence[Section], script: Script | None = None) -> None:
        self.sections = list(sections)
        self.script = script

    @property
    def units(self) -> list[Unit]:
        """The units in floor order."""
        return [section.unit for section in self.sections]

    def unit(self, address: int) -> Unit:
        """Return the first unit at ``address``. Raise KeyError if there is none."""
        return {unit.address: unit for unit in reversed(self.units)}[address]

    def settle(self) -> None:
        """Set every section to its commanded speed."""
        for section in self.sections:
            section.settle(self._master_rpm())

    def step(self, dt: float = STEP_S) -> None:
        if self.script is not None:
            self.script.step(dt)
        master_rpm = self._master_rpm()
        upstream: Section | None = None
        for section in self.sections:
            section.step(dt, master_rpm, upstream)
            upstream = section

    def _master_rpm(self) -> float:
        return next((section.rpm for section in self.sections if not section.unit.follows), 0.0)


LINE_SPEED = 1200
"""120.0 m/min, in the display units of every section."""


class _Machine(NamedTuple):
    """A section: ``draw`` is its speed as a part of the line's, ``ramp_s`` #6 and #7 in seconds."""

    name: str
    group: str
    draw: float
    ramp_s: int
    outputs: dict[int, str]


_MACHINES = (
    _Machine("Unwind", "Infeed", 0.995, 20, {1: "Brake release", 2: "Splice arm"}),
    _Machine("Infeed nip", "Infeed", 0.998, 15, {1: "Nip close"}),
    _Machine("Coater", "Coating", 1.0, 15, {1: "Blade load", 2: "Pump"}),
    _Machine("Dryer 1", "Drying", 1.001, 20, {1: "Hood fan", 2: "Steam valve"}),
    _Machine("Dryer 2", "Drying", 1.002, 20, {1: "Hood fan", 2: "Steam valve"}),
    _Machine("Cooling drum", "Drying", 1.002, 20, {1: "Chilled water"}),
    _Machine("Pull nip", "Outfeed", 1.004, 15, {1: "Nip close"}),
    _Machine("Rewind", "Outfeed", 1.006, 20, {1: "Brake release", 2: "Core chuck"}),
)


class DemoLine(NamedTuple):
    """The configuration of the units of a demonstration, and the plant that they drive."""

    settings: tuple[UnitSettings, ...]
    plant: Plant


def demo_line(
    units: int = 8,
    *,
    seed: int = 1,
    traits: Traits = ORDINARY,
    script: bool = True,
    unrest: bool = True,
) -> DemoLine:
    """Make ``units`` (1-255) sections in floor order at addresses 1, 2, …; same seed, same line. ``unrest``:
    whether speeds and tensions fluctuate a little, as on a machine.

    The first eight are set in m/min. In a longer line the machines repeat, and from the second eight on the
    last of each eight follows the master by ratio.
    """
    addresses = range(1, units + 1)
    sections = [_section(address, units, seed, traits, unrest) for address in addresses]
    operator = Script([section.unit for section in sections], seed=seed) if script else None
    plant = Plant(sections, operator)
    plant.settle()
    return DemoLine(tuple(_settings(address) for address in addresses), plant)


def _machine(address: int) -> _Machine:
    return _MACHINES[(address - 1) % len(_MACHINES)]


def _settings(address: int) -> UnitSettings:
    machine = _machine(address)
    bank = (address - 1) // len(_MACHINES)
    labels = UnitLabels(output=machine.outputs, analog="Web tension", analog_unit="N", unit="m/min")
    name = f"{machine.name} {chr(ord('A') + bank - 1)}" if bank else machine.name
    # The section where a web begins has no draw to the end of the web before.
    band = () if bank and machine is _MACHINES[0] else None
    return UnitSettings(id=address, name=name, group=machine.group, draw_percent=band, labels=labels)


def _section(address: int, units: int, seed: int, traits: Traits, unrest: bool) -> Section:
    machine = _machine(address)
    draw = machine.draw + 0.001 * ((address - 1) // len(_MACHINES)) / max(units / 64, 1)
    changed: dict[int, int] = {
        numbers.ACCELERATION: machine.ramp_s * 10,
        numbers.DECELERATION: machine.ramp_s * 10,
        numbers.FOLLOWER_MODE: int(address > len(_MACHINES) and machine is _MACHINES[-1]),
        numbers.PRESET_SPEED: 300,
        numbers.OWN_ADDRESS: address,
        numbers.SPEED_SETPOINT: round(LINE_SPEED * draw),
        numbers.RATIO_SETPOINT: round(10000 * draw),
        numbers.ANALOG_IN_HIGH: 500,
    }
    unit = Unit(Memory(changed), traits)
    unit.random.seed(seed * 1000 + address)
    return Section(unit, seed=seed * 1000 + address, unrest=unrest)

"""A line of sections in floor order, and the operation of its contacts; stepped, without a clock."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from bus.simulator.section import Section
from bus.simulator.unit import Unit

STEP_S = 0.05
"""The physics' own step."""

Contact = Literal["run", "estop", "preset", "reverse", "up", "down"]


@dataclass(frozen=True, slots=True)
class Habit:
    """How often a contact of some section is closed, and for how long, in seconds."""

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
"""Rare enough that the line is mostly well: an operator taps a jog, and now and then something happens."""


class Script:
    """Works one contact of one section at a time for each habit; who and when comes from the seed."""

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
        """The first unit at ``address``. Raises KeyError where there is none."""
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

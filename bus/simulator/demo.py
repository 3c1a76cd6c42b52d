"""A line to look at: eight sections of a web coater, or any number of plausible ones."""

from __future__ import annotations

from typing import NamedTuple

from bus.catalogue import parameters as numbers
from bus.settings import UnitLabels, UnitSettings
from bus.simulator.plant import Plant, Script
from bus.simulator.section import Section
from bus.simulator.unit import ORDINARY, Memory, Traits, Unit

LINE_SPEED = 1200
"""120.0 m/min, in the display units of every section."""


class _Machine(NamedTuple):
    """One section: ``draw`` is its speed as a part of the line's, ``ramp_s`` #6 and #7 in seconds."""

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
    """The configuration of the units, and the plant that it drives."""

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
    """``units`` (1-255) sections in floor order at addresses 1, 2, …; same seed, same line.
    ``unrest``: speeds and tensions move a little, as on a machine.

    The first eight are set in m/min. In a longer line the machines repeat, and from the second eight on
    the last of each eight follows the master by ratio.
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
    # Where a web begins, there is no draw to the end of the one before.
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

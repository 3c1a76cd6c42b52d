"""What the status bits of a unit mean, in one place. Pure: a reading in, the conditions that hold out."""

from __future__ import annotations

from functools import lru_cache

from app.line.conditions.catalogue import STATUS
from app.line.conditions.evidence import BusValues, UnitValues
from bus.catalogue.numbers import CONTROL_MODE
from bus.catalogue.status import StatusBits, status_bits
from bus.contract import Reading

KEYLOCK = 2
"""#19 of a unit whose keypad is locked (manual, 4.0)."""
_TURNING = frozenset(("turning",))


def bits_of(bus: BusValues, reading: Reading) -> StatusBits:
    """The bits of a reading in the dialect of its bus."""
    return status_bits(reading.outputs, reading.inputs, bus.settings.estop_healthy)


def is_driven(bits: StatusBits) -> bool:
    """Whether the drive may move its motor: run input on and no emergency stop."""
    return bits.run and not bits.estop_active


def mode_of(unit: UnitValues, bits: StatusBits) -> str:
    """``remote`` is from the unit (ST2); LOCAL and KEYLOCK are distinguished by #19."""
    if bits.remote:
        return "remote"
    return "keylock" if unit.parameter_raw(CONTROL_MODE) == KEYLOCK else "local"


@lru_cache(maxsize=4096)
def status_conditions(bits: StatusBits) -> frozenset[str]:
    """The codes of the conditions whose bit is set so."""
    return frozenset(code for code, holds in STATUS.items() if holds(bits))


def conditions_of(bits: StatusBits, reading: Reading) -> frozenset[str]:
    """The same by a reading, and ``turning`` while its actual speed is not 0."""
    found = status_conditions(bits)
    return found | _TURNING if reading.actual else found

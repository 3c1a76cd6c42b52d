"""What the status bits of a unit mean, in one place. Pure: a reading in, the conditions that hold out."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

from bus.catalogue.numbers import CONTROL_MODE
from bus.catalogue.status import StatusBits, status_bits
from bus.contract import Reading

if TYPE_CHECKING:
    from app.live.state.bus_live import BusLive, UnitLive

StatusCondition = Literal["estop_active", "run_off", "not_in_remote", "not_at_speed", "turning"]
KEYLOCK = 2
"""#19 of a unit whose keypad is locked (manual, 4.0)."""


STATUS_CONDITIONS: dict[StatusCondition, Callable[[StatusBits], bool]] = {
    "estop_active": lambda bits: bits.estop_active,
    "run_off": lambda bits: not bits.run,
    "not_in_remote": lambda bits: not bits.remote,
    "not_at_speed": lambda bits: not bits.at_speed,
}
"""The conditions of single bits of ST1 or ST2 (manual, 81h)."""
_TURNING: frozenset[StatusCondition] = frozenset(("turning",))


def bits_of(bus: BusLive, reading: Reading) -> StatusBits:
    """The bits of a reading in the dialect of its bus."""
    return status_bits(reading.outputs, reading.inputs, bus.settings.estop_healthy)


def is_driven(bits: StatusBits) -> bool:
    """Whether the drive may move its motor: run input on and no emergency stop."""
    return bits.run and not bits.estop_active


def mode_of(unit: UnitLive, bits: StatusBits) -> str:
    """``remote`` is from the unit (ST2); LOCAL and KEYLOCK are distinguished by #19."""
    if bits.remote:
        return "remote"
    return "keylock" if unit.parameter_raw(CONTROL_MODE) == KEYLOCK else "local"


@lru_cache(maxsize=4096)
def status_conditions(bits: StatusBits) -> frozenset[StatusCondition]:
    return frozenset(name for name, holds in STATUS_CONDITIONS.items() if holds(bits))


def conditions_of(bits: StatusBits, reading: Reading) -> frozenset[StatusCondition]:
    """All conditions that hold by a reading."""
    found = status_conditions(bits)
    return found | _TURNING if reading.actual else found

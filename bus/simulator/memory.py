"""The parameter memory of one simulated unit: what it is delivered with, and what it takes (manual, 4.0)."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from bus.catalogue import numbers
from bus.catalogue.parameters import PARAMETERS


class Mode(IntEnum):
    """#19, in the order of its title."""

    LOCAL = 0
    REMOTE = 1
    KEYLOCK = 2


FACTORY: Mapping[int, int] = {
    **dict.fromkeys(PARAMETERS, 0),
    numbers.MAX_RPM: 1750,
    numbers.MAX_DISPLAY: 2000,
    numbers.DECIMALS: 1,
    numbers.BASE_RATIO: 10000,
    numbers.ENCODER_PPR: 60,
    numbers.ACCELERATION: 100,
    numbers.DECELERATION: 100,
    numbers.PRESET_SPEED: 200,
    numbers.JUMP_UP: 5,
    numbers.JUMP_DOWN: 5,
    numbers.AT_SPEED_WINDOW: 10,
    numbers.JUMP_MODE: 1,
    numbers.DISPLAY_RATE: 10,
    numbers.SETUP_DURING_RUN: 1,
    numbers.OWN_ADDRESS: 1,
    numbers.BAUD_RATE: 96,
    numbers.CONTROL_MODE: Mode.REMOTE,
    numbers.ANALOG_IN_HIGH: 255,
    numbers.ANALOG_IN_RATE: 10,
    numbers.ANALOG_OUT_SOURCE: 2,
    numbers.ANALOG_OUT_HIGH: 2000,
    numbers.MAX_RATIO: 20000,
    numbers.RATIO_SETPOINT: 10000,
    numbers.MIN_RATIO: 5000,
    numbers.DEBOUNCE: 20,
}
"""A unit out of its box: address 1 at 9600 baud; in REMOTE, so that a host can be tried on it."""

LEGAL_BAUD_NUMBERS = frozenset({3, 6, 12, 24, 48, 96})
_WIDTHS = {"UCHR": 1, "UINT": 2, "ULNG": 4}


class Memory(dict[int, int]):
    """Forty numbers, as delivered but for ``changed``; an old firmware's list had its ``last`` at 20.

    A dict and not a wrapper around one: the physics of 255 units looks up a hundred thousand a second.
    """

    def __init__(self, changed: Mapping[int, int] | None = None, last: int = 40) -> None:
        super().__init__(FACTORY)
        self.update(changed or {})
        self.last = last

    def has(self, number: int) -> bool:
        """Whether this unit's firmware knows the parameter."""
        return 1 <= number <= self.last

    def takes(self, number: int, raw: int) -> bool:
        """Whether ``raw`` is a value that the parameter can hold, by its printed range and its kind."""
        parameter = PARAMETERS[number]
        if not parameter.minimum <= raw <= parameter.maximum:
            return False
        if number == numbers.BAUD_RATE:
            return raw in LEGAL_BAUD_NUMBERS
        if number == numbers.SPEED_SETPOINT:
            return raw <= self[numbers.MAX_DISPLAY]
        if number == numbers.RATIO_SETPOINT:
            return self[numbers.MIN_RATIO] <= raw <= self[numbers.MAX_RATIO]
        return True


def width_by_type(number: int) -> int:
    """Bytes of the parameter's data type: UCHR 1, UINT 2, ULNG 4."""
    return _WIDTHS[PARAMETERS[number].type]

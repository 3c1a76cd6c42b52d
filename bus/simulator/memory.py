"""The parameter memory of one simulated unit: what it is delivered with, and what it takes (manual, 4.0)."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from bus.catalogue.parameters import PARAMETERS


class Prm(IntEnum):
    """The parameters that the simulation itself looks at, by their numbers."""

    MAX_RPM = 1
    MAX_DISPLAY = 2
    DECIMALS = 3
    BASE_RATIO = 4
    ACCELERATION = 6
    DECELERATION = 7
    FOLLOWING = 8
    PRESET = 9
    JUMP_UP = 10
    JUMP_DOWN = 11
    WINDOW = 12
    JUMP_MODE = 13
    SETUP_DURING_RUN = 16
    ADDRESS = 17
    BAUD = 18
    MODE = 19
    SETPOINT = 20
    ANALOG_SOURCE = 28
    ANALOG_LOW = 29
    ANALOG_HIGH = 30
    MAX_RATIO = 31
    RATIO = 37
    MIN_RATIO = 38


class Mode(IntEnum):
    """#19, in the order of its title."""

    LOCAL = 0
    REMOTE = 1
    KEYLOCK = 2


FACTORY: Mapping[int, int] = {
    **dict.fromkeys(range(1, 41), 0),
    1: 1750,
    2: 2000,
    3: 1,
    4: 10000,
    5: 60,
    6: 100,
    7: 100,
    9: 200,
    10: 5,
    11: 5,
    12: 10,
    13: 1,
    15: 10,
    16: 1,
    17: 1,
    18: 96,
    19: Mode.REMOTE,
    23: 255,
    25: 10,
    28: 2,
    30: 2000,
    31: 20000,
    37: 10000,
    38: 5000,
    39: 20,
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
        if number == Prm.BAUD:
            return raw in LEGAL_BAUD_NUMBERS
        if number == Prm.SETPOINT:
            return raw <= self[Prm.MAX_DISPLAY]
        if number == Prm.RATIO:
            return self[Prm.MIN_RATIO] <= raw <= self[Prm.MAX_RATIO]
        return True


def width_by_type(number: int) -> int:
    """Bytes of the parameter's data type: UCHR 1, UINT 2, ULNG 4."""
    return _WIDTHS[PARAMETERS[number].type]

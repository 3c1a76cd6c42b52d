"""The values that can be requested by name, and the position of each in a reading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ValueKind = Literal["speed", "analog", "bit"]

_INPUTS = ("run", "estop", "preset", "reverse", "up", "down", "slave")
"""ST1, bit 0 first (manual, READ SPEED AND STATUS)."""
_OUTPUTS = tuple(f"output.{n}" for n in range(1, 7))
"""ST2, bit 0 first; then bits 6 and 7."""


@dataclass(frozen=True, slots=True)
class Value:
    """One value of a unit. ``bit`` is its place in ST2 * 256 + ST1; -1 for a number."""

    name: str
    kind: ValueKind
    column: Literal["commanded", "actual", "analog", "word"]
    bit: int = -1


VALUES: dict[str, Value] = {
    value.name: value
    for value in (
        Value("commanded", "speed", "commanded"),
        Value("actual", "speed", "actual"),
        Value("analog", "analog", "analog"),
        *(Value(name, "bit", "word", bit) for bit, name in enumerate(_INPUTS)),
        *(Value(name, "bit", "word", 8 + bit) for bit, name in enumerate((*_OUTPUTS, "remote", "at_speed"))),
    )
}
"""Every value by its name, as ``GET /api/v1/history`` takes it."""

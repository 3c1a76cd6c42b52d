"""The values that can be requested by name: position in a reading, label and unit of measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from bus.settings import BusSettings, UnitSettings

ValueKind = Literal["speed", "analog", "draw", "bit"]

_INPUTS = {
    "run": "run",
    "estop": "emergency stop",
    "preset": "preset",
    "reverse": "reverse",
    "up": "up",
    "down": "down",
    "slave": "follower",
}
"""ST1, bit 0 first (manual, READ SPEED AND STATUS)."""
_OUTPUTS = {f"output.{n}": "output {n}" for n in range(1, 7)} | {"remote": "remote", "at_speed": "at speed"}
"""ST2, bit 0 first."""


@dataclass(frozen=True, slots=True)
class Value:
    """One value of a unit. ``words`` names it in English, ``{n}`` is the number of an output; ``bit`` is its
    place in ST2 * 256 + ST1; -1 for a number. A draw is not stored, but made of two of its ``column``: that
    of the unit before, and its own."""

    name: str
    kind: ValueKind
    column: Literal["commanded", "actual", "analog", "word"]
    bit: int = -1
    words: str = ""


VALUES: dict[str, Value] = {
    value.name: value
    for value in (
        Value("commanded", "speed", "commanded", words="commanded"),
        Value("actual", "speed", "actual", words="actual"),
        Value("analog", "analog", "analog", words="analog input"),
        Value("draw", "draw", "actual", words="draw"),
        *(Value(name, "bit", "word", bit, words) for bit, (name, words) in enumerate(_INPUTS.items())),
        *(Value(name, "bit", "word", 8 + bit, words) for bit, (name, words) in enumerate(_OUTPUTS.items())),
    )
}
"""Every value by its name, as ``GET /api/v1/history`` takes it."""


def unit_settings(bus: BusSettings, number: int) -> UnitSettings:
    return next(unit for unit in bus.unit if unit.id == number)


def text(value: Value, translate: Callable[..., str]) -> str:
    """Its name in the language of ``translate``, which is called with English words and what they name."""
    return translate(value.words, n=value.name.removeprefix("output."))


def label(unit: UnitSettings, value: Value) -> str:
    """The wiring by the unit's labels; empty without one."""
    if value.kind == "analog":
        return unit.labels.analog
    if value.name.startswith("output."):
        return unit.labels.output.get(int(value.name.removeprefix("output.")), "")
    return {str(name): text for name, text in unit.labels.input.items()}.get(value.name, "")


def measure(unit: UnitSettings, value: Value) -> str:
    """The unit of measure; empty where none is configured."""
    return {"speed": unit.labels.unit, "analog": unit.labels.analog_unit, "draw": "%", "bit": ""}[value.kind]

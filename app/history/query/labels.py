"""What a value is called and in what it is measured, from the labels of lineside.toml."""

from __future__ import annotations

from app.history.series.values import Value
from bus.settings import BusSettings, UnitSettings


def unit_settings(bus: BusSettings, number: int) -> UnitSettings:
    """A configured unit."""
    return next(unit for unit in bus.unit if unit.id == number)


def label(unit: UnitSettings, value: Value) -> str:
    """The wiring by the unit's labels; empty without one."""
    if value.kind == "analog":
        return unit.labels.analog
    if value.name.startswith("output."):
        return unit.labels.output.get(int(value.name.removeprefix("output.")), "")
    return {str(name): text for name, text in unit.labels.input.items()}.get(value.name, "")


def measure(unit: UnitSettings, value: Value) -> str:
    """The unit of measure; empty where none is configured."""
    return {"speed": unit.labels.unit, "analog": unit.labels.analog_unit, "bit": ""}[value.kind]

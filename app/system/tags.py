"""The tags of a unit, its values for the plant's systems by MQTT and OPC UA, with names, engineering units
and ranges. Pure.

Speeds are in display units by the unit's own decimals (#3); a value is None while it, or its scale, was not
read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from app.line.live.api.view import analog_value
from app.line.live.bus_live import BusLive, UnitLive, bits_of, quantity_of, speed_decimals
from bus.catalogue.parameters import ANALOG_IN_HIGH, ANALOG_IN_LOW, MAX_DISPLAY, PARAMETERS, Parameter
from bus.catalogue.values import (
    HIGHEST_SPEED,
    MAX_DECIMALS,
    OUTPUT_NUMBERS,
    parameter_decimals,
    parameter_unit,
    plausible_parameter,
)
from bus.contract import Reading

Value = bool | int | float | str | None
Kind = Literal["number", "integer", "bit", "text"]
INPUTS = {
    "run": "Run",
    "estop": "Emergency stop",
    "preset": "Preset",
    "reverse": "Reverse",
    "up": "Up",
    "down": "Down",
    "slave": "Follower",
}
"""The inputs of ST1 with their names, for inputs without a label."""
OUTPUTS = {f"output_{number}": f"Output {number}" for number in OUTPUT_NUMBERS}
OF_READING = 5 + len(INPUTS) + len(OUTPUTS)
"""The number of tags from a response to 81h; they come first."""
LINK, ALARMS = OF_READING, OF_READING + 1
"""The places of the state of the link and of the number of active alarms."""
SHOWN_PARAMETERS = tuple(each for each in PARAMETERS.values() if not each.secret)


@dataclass(frozen=True, slots=True)
class Tag:
    """A value of a unit. ``name``: with folders, ``Speed/Actual``; ``unit``: its engineering unit; ``low``,
    ``high``: its range; ``decimals``: significant places, for a parameter those of its raw integer;
    ``column``: its name in a row of the history, empty if it has none."""

    name: str
    kind: Kind
    unit: str = ""
    low: float | None = None
    high: float | None = None
    decimals: int | None = None
    description: str = ""
    column: str = ""


@dataclass(frozen=True, slots=True)
class Scale:
    """The scale of a unit's values; after a change its tags have other units or ranges. ``measure``: of its
    speeds, empty for ratios."""

    decimals: int | None
    maximum: int | None
    measure: str
    analog: tuple[int | None, int | None]

    @property
    def divisor(self) -> int | None:
        """The divisor of a speed as sent; None while that is not known."""
        return None if self.decimals is None or self.decimals > MAX_DECIMALS else 10**self.decimals


def scale_now(bus: BusLive, unit: UnitLive) -> Scale:
    """Return the present scale of a unit's values."""
    decimals = speed_decimals(bus, unit)
    measure = quantity_of(bus, unit)
    maximum = HIGHEST_SPEED if measure is None else unit.parameter_raw(MAX_DISPLAY)
    analog = unit.parameter_raw(ANALOG_IN_LOW), unit.parameter_raw(ANALOG_IN_HIGH)
    return Scale(decimals, maximum, measure or "", analog)


def tags_of(unit: UnitLive, scale: Scale) -> tuple[Tag, ...]:
    """Return the tags of a unit. Their number and order never change."""
    labels = unit.settings.labels
    divisor, maximum = scale.divisor, scale.maximum
    most = None if divisor is None or maximum is None else maximum / divisor
    speed = (scale.measure, 0.0, most, scale.decimals)
    low, high = scale.analog
    return (
        Tag("Speed/Actual", "number", *speed, column="actual"),
        Tag("Speed/Commanded", "number", *speed, column="commanded"),
        Tag("Analog", "number", labels.analog_unit, low, high, description=labels.analog, column="analog"),
        Tag("At speed", "bit", column="at_speed"),
        Tag("Remote", "bit", column="remote"),
        *_named("Inputs", INPUTS, labels.input),
        *_named("Outputs", OUTPUTS, {f"output_{number}": label for number, label in labels.output.items()}),
        Tag("Link/State", "text"),
        Tag("Alarms/Active", "integer"),
        *(_parameter(each, scale) for each in SHOWN_PARAMETERS),
    )


def _named(folder: str, usual: Mapping[str, str], labels: Mapping[Any, str]) -> Iterator[Tag]:
    """Yield bits by their labels; of two labels that are equal, at least without case, the second gets its
    own name appended."""
    taken: set[str] = set()
    for column, plain in usual.items():
        name = (labels.get(column) or plain).replace("/", "-")
        if name.casefold() in taken:
            name = f"{name} ({column.replace('_', ' ')})"
        taken.add(name.casefold())
        yield Tag(f"{folder}/{name}", "bit", column=column)


def _parameter(parameter: Parameter, scale: Scale) -> Tag:
    decimals = parameter_decimals(parameter, scale.decimals)
    return Tag(
        f"Parameters/{parameter.number:02d}",
        "integer",
        parameter_unit(parameter),
        parameter.minimum,
        parameter.maximum,
        decimals,
        parameter.name,
    )


def reading_values(bus: BusLive, unit: UnitLive, reading: Reading, scale: Scale) -> tuple[Value, ...]:
    """Return the values of a reading, in the order of the tags."""
    bits = bits_of(bus, reading)
    divisor = scale.divisor
    speeds = (
        None if raw is None or divisor is None else raw / divisor
        for raw in (reading.actual, reading.commanded)
    )
    inputs = (bits.run, bits.estop_active, bits.preset, bits.reverse, bits.up, bits.down, bits.follower)
    return (*speeds, analog_value(unit, reading.analog), bits.at_speed, bits.remote, *inputs, *bits.outputs)


def other_values(unit: UnitLive, link: str, alarms: int) -> tuple[Value, ...]:
    """Return the values after those of a reading: link, alarms, parameters as raw integers."""
    known = unit.parameters
    raw = (known[each.number].raw if each.number in known else None for each in SHOWN_PARAMETERS)
    return (
        link,
        alarms,
        *(plausible_parameter(each.number, one) for each, one in zip(SHOWN_PARAMETERS, raw, strict=True)),
    )


def unique_names(names: Iterable[tuple[int, str]]) -> dict[int, str]:
    """Return the names of units by number; names that are equal without case get the number appended
    (Sparkplug 3.0, 4.1: avoid ids that are equal in lower case)."""
    given = list(names)
    folded = [name.casefold() for _, name in given]
    return {
        number: name if folded.count(name.casefold()) == 1 else f"{name} ({number})" for number, name in given
    }

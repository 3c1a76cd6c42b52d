"""The site's own alarms (``[[alarm]]`` of lineside.toml)."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from typing import Annotated, Literal

from pydantic import Field, StrictBool, model_validator
from pydantic_core import PydanticCustomError

from bus.settings import BusSettings, StrictModel
from bus.text import OneLine

SPEED_VALUES = ("commanded", "actual", "deviation")
INPUT_VALUES = ("run", "estop", "preset", "reverse", "up", "down", "slave")
OwnValue = Literal[
    "commanded",
    "actual",
    "deviation",
    "analog",
    "run",
    "estop",
    "preset",
    "reverse",
    "up",
    "down",
    "slave",
    "output.1",
    "output.2",
    "output.3",
    "output.4",
    "output.5",
    "output.6",
]
"""``deviation``: the distance of actual from commanded speed; ``estop`` is on while an e-stop is active."""
Limit = Annotated[Decimal, Field(max_digits=9, decimal_places=4)]
Delay = Annotated[float, Field(strict=True, ge=0, le=86_400)]


class AlarmSettings(StrictModel):
    """A limit of a value, its rate of change, or a state that lasts too long; numbers as on the display."""

    name: Annotated[OneLine, Field(min_length=1, max_length=80)]
    bus: str
    unit: Annotated[int, Field(strict=True, ge=1, le=255)]
    value: OwnValue
    above: Limit | None = None
    below: Limit | None = None
    deadband: Annotated[Limit, Field(ge=0)] = Decimal(0)
    change_per_s: Annotated[Limit | None, Field(gt=0)] = None
    """The value changes faster than this, in either direction."""
    state: Literal["on", "off"] | None = None
    """An input or an output is in this state for longer than ``on_delay_s``."""
    on_delay_s: Delay = 0.0
    off_delay_s: Delay = 0.0
    realarm_s: Annotated[float, Field(strict=True, ge=60, le=86_400)] | None = None
    priority: Literal["urgent", "high", "medium", "low"] = "medium"
    latch: StrictBool = False
    cause: Annotated[OneLine, Field(max_length=300)] = ""
    consequence: Annotated[OneLine, Field(max_length=300)] = ""
    response: Annotated[OneLine, Field(max_length=300)] = ""

    @model_validator(mode="after")
    def _has_one_condition(self) -> AlarmSettings:
        is_bit = self.value in INPUT_VALUES or self.value.startswith("output.")
        limited = self.above is not None or self.below is not None
        if is_bit and (limited or self.change_per_s is not None or self.deadband):
            raise ValueError(f'{self.value} is on or off; write state = "on" or "off" instead of a limit')
        if not is_bit and self.state is not None:
            raise ValueError(f"{self.value} is a number; write above or below instead of state")
        if [limited, self.change_per_s is not None, self.state is not None].count(True) != 1:
            right = 'state = "on" or "off"' if is_bit else "above, below or both, or change_per_s"
            raise ValueError(f"write one condition: {right}")
        return self

    @model_validator(mode="after")
    def _deadband_fits(self) -> AlarmSettings:
        if self.change_per_s is not None and self.deadband:
            raise ValueError("deadband belongs to above and below; use off_delay_s with change_per_s")
        if self.above is not None and self.below is not None:
            if self.below >= self.above:
                raise ValueError("below is not less than above; every value would be outside")
            if self.deadband >= (self.above - self.below) / 2:
                raise ValueError(
                    "deadband is wider than half the distance of the limits; the alarm would never clear"
                )
        elif self.above is not None and self.value != "analog" and self.deadband > self.above:
            raise ValueError("deadband is wider than the limit; the alarm would never clear")
        return self


def refuse_misplaced(alarms: Iterable[AlarmSettings], buses: Iterable[BusSettings]) -> None:
    """Raises PydanticCustomError for an alarm on a unit that is not configured, or a name given twice."""
    units = {bus.name: {unit.id for unit in bus.unit} for bus in buses}
    names: set[tuple[str, str]] = set()
    for index, alarm in enumerate(alarms):
        key, context = "bus", {"name": alarm.name, "bus": alarm.bus, "unit": alarm.unit}
        if alarm.bus not in units:
            message = "alarm {name}: there is no bus {bus}; name one that is configured"
        elif alarm.unit not in units[alarm.bus]:
            key, message = "unit", "alarm {name}: bus {bus} has no unit {unit}; name one that is configured"
        elif (alarm.bus, alarm.name) in names:
            key, message = "name", "alarm {name} is given twice for bus {bus}; give each its own name"
        else:
            names.add((alarm.bus, alarm.name))
            continue
        raise PydanticCustomError("misplaced", message, context | {"at": ("alarm", index, key)})

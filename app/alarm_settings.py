"""The site's own alarms (``[[alarm]]`` of lineside.toml)."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from typing import Annotated, Literal

from pydantic import Field, StrictBool, model_validator
from pydantic_core import PydanticCustomError

from bus.messages import Message
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
            raise self._refusal("setting_alarm_of_bit")
        if not is_bit and self.state is not None:
            raise self._refusal("setting_alarm_of_number")
        if [limited, self.change_per_s is not None, self.state is not None].count(True) != 1:
            raise self._refusal(f"setting_alarm_one_{'state' if is_bit else 'limit'}")
        return self

    @model_validator(mode="after")
    def _deadband_fits(self) -> AlarmSettings:
        if self.change_per_s is not None and self.deadband:
            raise self._refusal("setting_alarm_deadband_of_rate")
        if self.above is not None and self.below is not None:
            if self.below >= self.above:
                raise self._refusal("setting_alarm_limits_reversed")
            if self.deadband >= (self.above - self.below) / 2:
                raise self._refusal("setting_alarm_deadband_wide")
        elif self.above is not None and self.value != "analog" and self.deadband > self.above:
            raise self._refusal("setting_alarm_deadband_wide")
        return self

    def _refusal(self, code: str) -> PydanticCustomError:
        return _refusal(Message.of(code, name=self.name, value=self.value))


def _refusal(message: Message, *at: int | str) -> PydanticCustomError:
    """``at``: where the fault is, from the table on that is judged."""
    return PydanticCustomError("alarm", "not an alarm", {"message": message, "at": at})


def refuse_misplaced(alarms: Iterable[AlarmSettings], buses: Iterable[BusSettings]) -> None:
    """Raises PydanticCustomError for an alarm on a unit that is not configured, or a name given twice."""
    units = {bus.name: {unit.id for unit in bus.unit} for bus in buses}
    names: set[tuple[str, str]] = set()
    for index, alarm in enumerate(alarms):
        if alarm.bus not in units:
            key = "bus"
        elif alarm.unit not in units[alarm.bus]:
            key = "unit"
        elif (alarm.bus, alarm.name) in names:
            key = "name"
        else:
            names.add((alarm.bus, alarm.name))
            continue
        message = Message.of(f"setting_alarm_{key}", name=alarm.name, bus=alarm.bus, unit=alarm.unit)
        raise _refusal(message, "alarm", index, key)

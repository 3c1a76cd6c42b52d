"""The site's own alarms (``[[alarm]]`` of lineside.toml), and the limits and delays that it sets for built-in
ones (``[[built_in_alarm]]``)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, Field, StrictBool, model_validator
from pydantic_core import PydanticKnownError

from app.core.former_settings import FORMER_ALARMS
from app.line.conditions.catalogue import BUS_ALARMS, CONDITIONS, SERVER_ALARMS, UNIT_ALARMS
from app.line.conditions.condition import AlarmPriority, Tuning
from bus.messages import Message
from bus.settings import BusSettings, StrictModel
from bus.validation import OneLine, setting_fault

SpeedValue = Literal["commanded", "actual", "deviation"]
"""``deviation``: the distance of actual from commanded speed."""
InputValue = Literal["run", "estop", "preset", "reverse", "up", "down", "slave"]
"""``estop`` is on while an e-stop is active."""
OutputValue = Literal["output.1", "output.2", "output.3", "output.4", "output.5", "output.6"]
OwnValue = Literal[SpeedValue, "analog", InputValue, OutputValue]
SPEED_VALUES: tuple[SpeedValue, ...] = get_args(SpeedValue)
INPUT_VALUES: tuple[InputValue, ...] = get_args(InputValue)
Limit = Annotated[Decimal, Field(max_digits=9, decimal_places=4, description="As the unit displays it.")]
Percent = Annotated[Decimal, Field(ge=0, le=100, max_digits=6, decimal_places=3)]
Delay = Annotated[float, Field(strict=True, ge=0, le=86_400, description="Seconds.")]
AddressSetting = Annotated[
    int, Field(strict=True, ge=1, le=255, description="Address of the unit (#17), 1 to 255.")
]


class AlarmSettings(StrictModel):
    """An alarm of a value beyond a limit, of its rate of change, or of a state that lasts too long; numbers
    as on the display."""

    name: Annotated[OneLine, Field(min_length=1, max_length=80)]
    bus: str
    unit: AddressSetting
    value: OwnValue
    above: Limit | None = None
    below: Limit | None = None
    deadband: Annotated[Limit, Field(ge=0)] = Decimal(0)
    change_per_s: Annotated[Limit | None, Field(gt=0)] = None
    """The change per second, in either direction, above which the alarm comes."""
    state: Literal["on", "off"] | None = None
    """The state of an input or an output that brings the alarm after ``on_delay_s``."""
    on_delay_s: Delay = 0.0
    off_delay_s: Delay = 0.0
    realarm_s: Annotated[
        Annotated[float, Field(strict=True, ge=60, le=86_400)] | None,
        Field(description="Seconds; null: never annunciated again."),
    ] = None
    priority: AlarmPriority = "medium"
    latch: StrictBool = False
    cause: Annotated[OneLine, Field(max_length=300)] = ""
    consequence: Annotated[OneLine, Field(max_length=300)] = ""
    response: Annotated[OneLine, Field(max_length=300)] = ""

    @model_validator(mode="after")
    def _limits_fit_the_value(self) -> AlarmSettings:
        fault = self._condition_fault() or self._deadband_fault()
        if fault is not None:
            raise setting_fault(Message.of(fault, name=self.name, value=self.value))
        return self

    def _condition_fault(self) -> str | None:
        """Return the code of the reason why the alarm does not have exactly one condition."""
        is_bit = self.value in INPUT_VALUES or self.value.startswith("output.")
        limited = self.above is not None or self.below is not None
        if is_bit and (limited or self.change_per_s is not None or self.deadband):
            return "setting_alarm_of_bit"
        if not is_bit and self.state is not None:
            return "setting_alarm_of_number"
        if [limited, self.change_per_s is not None, self.state is not None].count(True) != 1:
            return f"setting_alarm_one_{'state' if is_bit else 'limit'}"
        return None

    def _deadband_fault(self) -> str | None:
        if self.change_per_s is not None and self.deadband:
            return "setting_alarm_deadband_of_rate"
        if self.above is not None and self.below is not None:
            if self.below >= self.above:
                return "setting_alarm_limits_reversed"
            if self.deadband >= (self.above - self.below) / 2:
                return "setting_alarm_deadband_wide"
        elif self.above is not None and self.value != "analog" and self.deadband > self.above:
            return "setting_alarm_deadband_wide"
        return None


def refuse_misplaced(alarms: Iterable[AlarmSettings], buses: Iterable[BusSettings]) -> None:
    """Raise PydanticCustomError for an alarm on a unit that is not configured, or a name given twice."""
    units = _units_of(buses)
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
        raise setting_fault(message, "alarm", index, key)


def _known(code: str) -> str:
    codes = (*UNIT_ALARMS, *BUS_ALARMS, *SERVER_ALARMS)
    if code not in (*codes, *FORMER_ALARMS):
        raise PydanticKnownError("literal_error", {"expected": ", ".join(map(repr, codes))})
    return code


class BuiltInAlarmSettings(StrictModel):
    """A change of a built-in alarm: everywhere, on one bus, or of one unit."""

    code: Annotated[str, AfterValidator(_known)]
    bus: str | None = None
    unit: AddressSetting | None = None
    above_percent: Percent | None = None
    """A percentage of the maximum display value (#2), or of the range of the analog input."""
    below_percent: Percent | None = None
    deadband_percent: Percent | None = None
    on_delay_s: Delay | None = None
    off_delay_s: Delay | None = None

    @property
    def place(self) -> tuple[str, str | None, int | None]:
        """The code, the bus and the unit."""
        return self.code, self.bus, self.unit

    @property
    def changed(self) -> dict[str, Decimal | float]:
        """The limits and delays that the entry sets."""
        return self.model_dump(exclude={"code", "bus", "unit"}, exclude_none=True)

    def covers(self, code: str, bus: str | None, unit: int | None) -> bool:
        """Return whether the entry is about this alarm at this place."""
        return self.code == code and self.bus in (None, bus) and self.unit in (None, unit)


def tuning_of(
    entries: Iterable[BuiltInAlarmSettings], code: str, bus: str | None, unit: int | None
) -> Tuning:
    """Return the limits and delays of an alarm: those set for its unit, else for its bus, else everywhere,
    else those of its condition."""
    found = CONDITIONS[code].tuning
    covering = [each for each in entries if each.covers(code, bus, unit)]
    for each in sorted(covering, key=lambda each: (each.bus is not None, each.unit is not None)):
        found = replace(found, **each.changed)  # type: ignore[arg-type]
    return found


SettingFault = tuple[str, str, dict[str, str | int]]
"""The code of a message, the key that is wrong, and further values of the message."""


def refuse_built_in(entries: Sequence[BuiltInAlarmSettings], buses: Iterable[BusSettings]) -> None:
    """Raise PydanticCustomError for an entry at a place that its alarm does not have, one that sets nothing
    or keys that its alarm does not have, one given twice, and limits that no value can keep."""
    units = _units_of(buses)
    for index, each in enumerate(entries):
        if each.code in FORMER_ALARMS:
            continue
        before = [other.place for other in entries[:index]]
        for code, key, more in (*_misplaced(each, units), *_misset(each)):
            raise setting_fault(Message.of(code, name=each.code, **more), "built_in_alarm", index, key)
        fault = "setting_built_in_twice" if each.place in before else tuning_of(entries, *each.place).fault
        if fault:
            raise setting_fault(Message.of(fault, name=each.code), "built_in_alarm", index, "code")


def _misplaced(each: BuiltInAlarmSettings, units: Mapping[str, set[int]]) -> Iterator[SettingFault]:
    if each.bus is not None and each.code in SERVER_ALARMS:
        yield "setting_built_in_of_server", "bus", {}
    elif each.unit is not None and each.code not in UNIT_ALARMS:
        yield "setting_built_in_of_bus", "unit", {}
    elif each.unit is not None and each.bus is None:
        yield "setting_built_in_bus_missing", "unit", {}
    elif each.bus is not None and each.bus not in units:
        yield "setting_alarm_bus", "bus", {"bus": each.bus}
    elif each.bus is not None and each.unit is not None and each.unit not in units[each.bus]:
        yield "setting_alarm_unit", "unit", {"bus": each.bus, "unit": each.unit}


def _misset(each: BuiltInAlarmSettings) -> Iterator[SettingFault]:
    usual = CONDITIONS[each.code].tuning
    known = ["on_delay_s", "off_delay_s"]
    if usual.above_percent is not None:
        limits = ("above_percent", "below_percent", "deadband_percent")
        known = [*(key for key in limits if getattr(usual, key) is not None), *known]
    keys = ", ".join(known)
    for key in each.changed:
        if key not in known:
            yield "setting_built_in_key", key, {"key": key, "keys": keys}
    if not each.changed:
        yield "setting_built_in_empty", "code", {"keys": keys}


def _units_of(buses: Iterable[BusSettings]) -> dict[str, set[int]]:
    return {bus.name: {unit.id for unit in bus.unit} for bus in buses}

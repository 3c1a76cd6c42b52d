"""Alarms that the site defines: parsed from the text of a person, defined, and checked by readings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from app.errors import Problem
from app.line.alarms.alarm import AlarmDefinition, AlarmRationalization, own_key
from app.line.alarms.rules import AlarmAttributes, ChangeRate, LimitRule
from app.line.alarms.settings import INPUT_VALUES, SPEED_VALUES, AlarmSettings, refuse_misplaced
from app.line.conditions.condition import MATRIX, AlarmPriority, Consequence, TimeToRespond
from app.line.live.bus_live import BusLive, UnitLive, bits_of, speed_decimals
from bus.catalogue.parameters import ANALOG_IN_HIGH, ANALOG_IN_LOW
from bus.catalogue.values import MAX_DECIMALS, analog_input_value
from bus.contract import Reading
from bus.messages import Message, number, term
from bus.settings import BusSettings
from bus.validation import fault_message

ANALOG_DECIMALS = 3
"""An analog input is compared in thousandths of its unit."""
_OF_PRIORITY: dict[AlarmPriority, tuple[Consequence, TimeToRespond]] = {
    priority: place for place, priority in reversed(MATRIX.items())
}
_CODES = {"deviation": "deviation", "analog": "analog_out_of_limits"}
_NO_LIMIT = LimitRule(None, None)
_RECORD_TEXTS = ("cause", "consequence", "response")


def own_definition(settings: AlarmSettings) -> AlarmDefinition:
    """Return an alarm by its settings; the site wrote its texts."""
    severity, time_to_respond = _OF_PRIORITY[settings.priority]
    cause, consequence, response = (
        Message.of("alarm_own_text", text=text) if text else Message("alarm_own_without_text")
        for text in (getattr(settings, name) for name in _RECORD_TEXTS)
    )
    is_speed = settings.value in SPEED_VALUES
    return AlarmDefinition(
        key=own_key(settings.bus, settings.unit, settings.name),
        code=_own_code(settings),
        name=settings.name,
        bus=settings.bus,
        unit=settings.unit,
        priority=settings.priority,
        record=AlarmRationalization(cause, consequence, response, severity, time_to_respond),
        attributes=AlarmAttributes(
            on_delay_s=settings.on_delay_s,
            off_delay_s=settings.off_delay_s,
            realarm_s=settings.realarm_s,
            latching=settings.latch,
        ),
        group="speed"
        if is_speed and (settings.below is not None or settings.value == "deviation")
        else "unit",
    )


def _own_code(settings: AlarmSettings) -> str:
    if settings.state is not None:
        return "state_too_long"
    if settings.change_per_s is not None:
        return "change_too_fast"
    return _CODES.get(settings.value, "value_out_of_limits")


def _analog(unit: UnitLive, reading: Reading) -> int | None:
    low, high = unit.parameter_raw(ANALOG_IN_LOW), unit.parameter_raw(ANALOG_IN_HIGH)
    if low is None or high is None or unit.scale_is_old:
        return None
    return round(1000 * analog_input_value(reading.analog, low, high))


_VALUES: dict[str, Callable[[UnitLive, Reading], int | None]] = {
    "actual": lambda _, reading: reading.actual,
    "commanded": lambda _, reading: reading.commanded,
    "deviation": lambda _, reading: None if reading.deviation is None else abs(reading.deviation),
}


@dataclass(slots=True)
class OwnCondition:
    """The condition of one alarm that the site defined. Limits are compared in integers, which are computed
    again when the decimals of the unit change: that costs 4 µs."""

    settings: AlarmSettings
    of_state: bool = field(init=False)
    """Whether the alarm is about an input or an output, which only a new status byte can change."""
    _value: Callable[[UnitLive, Reading], int | None] = field(init=False)
    _rate: ChangeRate = field(default_factory=ChangeRate)
    _decimals: int | None = None
    _rule: LimitRule = _NO_LIMIT

    def __post_init__(self) -> None:
        self.of_state = self.settings.state is not None
        self._value = _VALUES.get(self.settings.value, _analog)

    def holds(
        self, bus: BusLive, unit: UnitLive, reading: Reading, decimals: int | None, active: bool
    ) -> bool | None:
        """Return whether the condition holds by a reading; None while that is not known. ``decimals``: those
        of the speeds of the unit, None while they are not known."""
        settings = self.settings
        if self.of_state:
            return self._bit(bus, reading) == (settings.state == "on")
        value = self._value(unit, reading)
        if settings.value == "analog":
            decimals = ANALOG_DECIMALS
        if value is None or decimals is None:
            return None
        if settings.change_per_s is not None:
            per_s = self._rate.see(value, float(reading.at))
            return None if per_s is None else per_s > settings.change_per_s * 10**decimals
        if decimals != self._decimals:
            self._decimals, self._rule = decimals, _rule_of(settings, decimals)
        return self._rule.holds(value, active)

    def forget(self) -> None:
        """Forget the rate of change: the values were not known for a while."""
        self._rate.forget()

    def present(self, bus: BusLive, unit: UnitLive) -> Message | None:
        """Return the present value as the unit shows it; None while it is not known."""
        if unit.reading is None:
            return None
        if self.of_state:
            return term("on") if self._bit(bus, unit.reading) else term("off")
        value = self._value(unit, unit.reading)
        decimals = ANALOG_DECIMALS if self.settings.value == "analog" else known_decimals(bus, unit)
        if value is None or decimals is None:
            return None
        shown = Decimal(value).scaleb(-decimals)
        return number(shown.normalize() if self.settings.value == "analog" else shown)

    def _bit(self, bus: BusLive, reading: Reading) -> bool:
        bits, value = bits_of(bus, reading), self.settings.value
        if value in INPUT_VALUES:
            return bits.inputs[value]
        return bits.outputs[int(value.removeprefix("output.")) - 1]


def known_decimals(bus: BusLive, unit: UnitLive) -> int | None:
    """Return the decimals of the speeds of a unit; None while they are not known, or may have changed."""
    decimals = None if unit.scale_is_old else speed_decimals(bus, unit)
    return None if decimals is None or decimals > MAX_DECIMALS else decimals


def _rule_of(settings: AlarmSettings, decimals: int) -> LimitRule:
    def raw(limit: Decimal | None) -> int | None:
        return None if limit is None else round(limit.scaleb(decimals))

    return LimitRule(raw(settings.above), raw(settings.below), raw(settings.deadband) or 0)


def proposed(written: Mapping[str, Any], buses: Sequence[BusSettings]) -> AlarmSettings:
    """Return the settings of an alarm as a person wrote it. Raise Problem 422 with every fault in words."""
    try:
        settings = AlarmSettings.model_validate(written)
    except ValidationError as error:
        faults = [_fault(details) for details in error.errors()]
        raise Problem(422, "invalid", Message.of("several", messages=[*faults])) from None
    try:
        refuse_misplaced([settings], buses)
    except PydanticCustomError as error:
        raise Problem(422, "invalid", (error.context or {})["message"]) from None
    return settings


def _fault(details: ErrorDetails) -> Message:
    message: Message | None = details.get("ctx", {}).get("message")
    if message is not None:
        return message
    key = ".".join(str(step) for step in details["loc"])
    if details["type"] == "missing":
        return Message.of("own_alarm_lacks", key=key)
    right = fault_message(details)
    return Message.of("configuration_value", key=key, value=repr(details["input"]), right=right)


def in_toml(settings: AlarmSettings) -> str:
    """Return the entry for lineside.toml, without default values."""
    lines = ["[[alarm]]"]
    for key, value in settings.model_dump(mode="json", exclude_defaults=True).items():
        lines.append(f"{key} = {_toml(value)}")
    return "\n".join(lines)


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    return f"{value:g}" if isinstance(value, float) else str(value)

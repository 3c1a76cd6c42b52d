"""The built-in alarms by code, and their limits and delays (``[[built_in_alarm]]`` of lineside.toml)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from types import MappingProxyType
from typing import Annotated, Literal, get_args

from pydantic import Field
from pydantic_core import PydanticCustomError

from app.alarm_settings import Delay
from bus.messages import Message
from bus.settings import BusSettings, StrictModel

UnitAlarm = Literal[
    "unit_offline",
    "link_degraded",
    "estop_active",
    "not_at_speed",
    "running_without_run",
    "ratio_out_of_limits",
    "not_in_remote",
    "parameter_drift",
    "duplicate_address",
    "staged_left",
    "deviation",
    "analog_out_of_limits",
]
BusAlarm = Literal[
    "port_lost", "no_unit_responds", "worker_lost", "second_master", "wire_overloaded", "control_left"
]
SiteAlarm = Literal[
    "history_degraded",
    "audit_degraded",
    "disk_low",
    "notification_failed",
    "clock_stepped",
    "certificate_expiring",
    "token_expiring",
]
BuiltIn = UnitAlarm | BusAlarm | SiteAlarm
UNIT_ALARMS: tuple[UnitAlarm, ...] = get_args(UnitAlarm)
BUS_ALARMS: tuple[BusAlarm, ...] = get_args(BusAlarm)
SITE_ALARMS: tuple[SiteAlarm, ...] = get_args(SiteAlarm)

Percent = Annotated[Decimal, Field(ge=0, le=100, max_digits=6, decimal_places=3)]
_LIMITS = ("above_percent", "below_percent", "deadband_percent")
_DELAYS = ("on_delay_s", "off_delay_s")


class BuiltInAlarmSettings(StrictModel):
    """Changes a built-in alarm: everywhere, on one bus, or of one unit."""

    code: BuiltIn
    bus: str | None = None
    unit: Annotated[int, Field(strict=True, ge=1, le=255)] | None = None
    above_percent: Percent | None = None
    """Of the maximum display value (#2), or of the range of the analog input."""
    below_percent: Percent | None = None
    deadband_percent: Percent | None = None
    on_delay_s: Delay | None = None
    off_delay_s: Delay | None = None

    @property
    def changed(self) -> dict[str, Decimal | float]:
        """What it sets."""
        found = self.model_dump(exclude={"code", "bus", "unit"}, exclude_none=True)
        return {key: value for key, value in found.items() if value is not None}

    def covers(self, code: str, bus: str | None, unit: int | None) -> bool:
        """Whether it is about this alarm at this place."""
        return self.code == code and self.bus in (None, bus) and self.unit in (None, unit)


@dataclass(frozen=True, slots=True)
class BuiltInTuning:
    """The limits of an alarm, in percent, and its delays where they are other than the usual ones."""

    above_percent: Decimal | None = None
    below_percent: Decimal | None = None
    deadband_percent: Decimal = Decimal(0)
    on_delay_s: float | None = None
    off_delay_s: float | None = None

    @property
    def fault(self) -> str:
        """The code of what is wrong with its limits; empty where nothing is."""
        above, below = self.above_percent, self.below_percent
        if above is None:
            return ""
        if below is not None and below >= above:
            return "setting_alarm_limits_reversed"
        room = above if below is None else (above - below) / 2
        return "setting_alarm_deadband_wide" if self.deadband_percent >= room else ""


USUAL: Mapping[str, BuiltInTuning] = MappingProxyType(
    {
        "deviation": BuiltInTuning(above_percent=Decimal(5), deadband_percent=Decimal(1)),
        "analog_out_of_limits": BuiltInTuning(Decimal("99.6"), Decimal("0.4"), Decimal("1.2")),
    }
)
"""Limits; the analog input is at an end of its range of 8 bits, where no transducer measures."""


def tuning_of(
    entries: Iterable[BuiltInAlarmSettings], code: BuiltIn, bus: str | None, unit: int | None
) -> BuiltInTuning:
    """What holds for an alarm: what is set for its unit before its bus, and that before everywhere."""
    found = USUAL.get(code, BuiltInTuning())
    covering = [each for each in entries if each.covers(code, bus, unit)]
    for each in sorted(covering, key=lambda each: (each.bus is not None, each.unit is not None)):
        found = replace(found, **each.changed)  # type: ignore[arg-type]
    return found


SettingFault = tuple[str, str, dict[str, str | int]]
"""The code of its message, the key that is wrong, and more values of the message."""


def refuse_built_in(entries: Sequence[BuiltInAlarmSettings], buses: Iterable[BusSettings]) -> None:
    """Raises PydanticCustomError for an entry at a place where its alarm is not, one that sets nothing or
    what its alarm has not, one given twice, and limits that no value can keep."""
    units = {bus.name: {unit.id for unit in bus.unit} for bus in buses}
    for index, each in enumerate(entries):
        for code, key, more in (*_misplaced(each, units), *_misset(each), *_conflicts(each, entries, index)):
            message = Message.of(code, name=each.code, **more)
            raise PydanticCustomError(
                "built_in_alarm", "not a setting", {"message": message, "at": ("built_in_alarm", index, key)}
            )


def _misplaced(each: BuiltInAlarmSettings, units: Mapping[str, set[int]]) -> Iterator[SettingFault]:
    if each.bus is not None and each.code in SITE_ALARMS:
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
    usual = USUAL.get(each.code)
    limits = _LIMITS if usual else ()
    known = (*(key for key in limits if getattr(usual, key) is not None), *_DELAYS)
    keys = ", ".join(known)
    for key in each.changed:
        if key not in known:
            yield "setting_built_in_key", key, {"key": key, "keys": keys}
    if not each.changed:
        yield "setting_built_in_empty", "code", {"keys": keys}


def _conflicts(
    each: BuiltInAlarmSettings, entries: Sequence[BuiltInAlarmSettings], index: int
) -> Iterator[SettingFault]:
    place = (each.code, each.bus, each.unit)
    if place in [(other.code, other.bus, other.unit) for other in entries[:index]]:
        yield "setting_built_in_twice", "code", {}
    fault = tuning_of(entries, *place).fault
    if fault:
        yield fault, "code", {}

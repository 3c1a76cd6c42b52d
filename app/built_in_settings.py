"""Limits and delays of the built-in alarms that a site sets (``[[built_in_alarm]]`` of lineside.toml)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from typing import Annotated

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError, PydanticKnownError

from app.alarm_settings import Delay
from app.conditions.catalogue import BUS_ALARMS, CONDITIONS, SERVER_ALARMS, UNIT_ALARMS
from app.conditions.condition import Tuning
from bus.messages import Message
from bus.settings import BusSettings, StrictModel

_CODES = (*UNIT_ALARMS, *BUS_ALARMS, *SERVER_ALARMS)


def _known(code: str) -> str:
    if code not in _CODES:
        raise PydanticKnownError("literal_error", {"expected": ", ".join(map(repr, _CODES))})
    return code


Percent = Annotated[Decimal, Field(ge=0, le=100, max_digits=6, decimal_places=3)]
_LIMITS = ("above_percent", "below_percent", "deadband_percent")
_DELAYS = ("on_delay_s", "off_delay_s")


class BuiltInAlarmSettings(StrictModel):
    """Changes a built-in alarm: everywhere, on one bus, or of one unit."""

    code: Annotated[str, AfterValidator(_known)]
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


def tuning_of(
    entries: Iterable[BuiltInAlarmSettings], code: str, bus: str | None, unit: int | None
) -> Tuning:
    """What holds for an alarm: what is set for its unit before its bus, and that before everywhere."""
    found = CONDITIONS[code].tuning
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
    limits = _LIMITS if usual.above_percent is not None else ()
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

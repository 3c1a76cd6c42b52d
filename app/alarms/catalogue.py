"""The built-in alarms, each by the row of its condition."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from app.alarms.alarm import AlarmDefinition, AlarmRationalization, key_of
from app.alarms.rules.facts import AlarmAttributes
from app.alarms.settings import BuiltInAlarmSettings, tuning_of
from app.conditions.catalogue import CONDITIONS
from app.conditions.condition import AlarmGroup, Tuning
from bus.messages import Message


def built_in(
    code: str, bus: str | None, unit: int | None = None, tuned: Iterable[BuiltInAlarmSettings] = ()
) -> AlarmDefinition:
    """The definition of a built-in alarm at its place. ``tuned``: the limits and delays that the site set."""
    row = CONDITIONS[code]
    name, record = _texts(code)
    usual: AlarmGroup = "drive" if unit is not None else "system" if bus is None else "communication"
    return AlarmDefinition(
        key=key_of(bus, unit, code),
        code=code,
        name=name,
        bus=bus,
        unit=unit,
        priority=row.priority,
        record=record,
        attributes=_attributes(tuning_of(tuned, code, bus, unit), row.latching),
        group=row.group,
        about=row.about or usual,
    )


@cache
def _texts(code: str) -> tuple[Message, AlarmRationalization]:
    """The same objects for every unit: a line has thousands of alarms."""
    row = CONDITIONS[code]
    name, cause, consequence, response = map(Message, row.texts)
    return name, AlarmRationalization(cause, consequence, response, *row.rated)


@cache
def _attributes(tuning: Tuning, latching: bool) -> AlarmAttributes:
    return AlarmAttributes(tuning.on_delay_s, tuning.off_delay_s, latching=latching)

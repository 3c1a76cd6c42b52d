"""The built-in alarms, each by the row of its condition."""

from __future__ import annotations

from app.alarms.definition import AlarmDefinition, Rationalization, key_of
from app.alarms.rules.facts import AlarmAttributes
from app.conditions.catalogue import CONDITIONS
from app.conditions.condition import AlarmGroup, Tuning
from bus.messages import Message


def built_in(
    code: str, bus: str | None, unit: int | None = None, tuning: Tuning | None = None
) -> AlarmDefinition:
    """The definition of a built-in alarm at its place. ``tuning``: of the site; None: the usual one."""
    row = CONDITIONS[code]
    tuning = tuning or row.tuning
    name, cause, consequence, response = map(Message, row.texts)
    usual: AlarmGroup = "drive" if unit is not None else "system" if bus is None else "communication"
    return AlarmDefinition(
        key=key_of(bus, unit, code),
        code=code,
        name=name,
        bus=bus,
        unit=unit,
        priority=row.priority,
        record=Rationalization(cause, consequence, response, *row.rated),
        attributes=AlarmAttributes(tuning.on_delay_s, tuning.off_delay_s, latching=row.latching),
        group=row.group,
        about=row.about or usual,
    )

"""The built-in alarms as data: the attributes of each; its priority is that of its condition."""

from __future__ import annotations

from dataclasses import dataclass, replace

from app.alarms.definition import AlarmDefinition, Rationalization, key_of
from app.alarms.rules.facts import PLAIN, AlarmAttributes
from app.alarms.rules.suppression import SuppressionGroup
from app.built_in_settings import BuiltIn, BuiltInTuning
from app.conditions.catalogue import CONDITIONS
from bus.messages import Message

NOT_TUNED = BuiltInTuning()


@dataclass(frozen=True, slots=True)
class BuiltInAlarm:
    """One row: how the alarm of a condition behaves. Its texts are messages named after its code."""

    attributes: AlarmAttributes = PLAIN
    group: SuppressionGroup | None = None


BUILT_IN: dict[BuiltIn, BuiltInAlarm] = {
    "unit_offline": BuiltInAlarm(group="unit"),
    "link_degraded": BuiltInAlarm(AlarmAttributes(off_delay_s=60), group="unit"),
    "estop_active": BuiltInAlarm(group="unit"),
    "not_at_speed": BuiltInAlarm(AlarmAttributes(on_delay_s=10, off_delay_s=2), group="speed"),
    "running_without_run": BuiltInAlarm(AlarmAttributes(on_delay_s=2), group="unit"),
    "ratio_out_of_limits": BuiltInAlarm(group="unit"),
    "not_in_remote": BuiltInAlarm(AlarmAttributes(on_delay_s=5), group="unit"),
    "parameter_drift": BuiltInAlarm(),
    "duplicate_address": BuiltInAlarm(AlarmAttributes(latching=True)),
    "staged_left": BuiltInAlarm(AlarmAttributes(on_delay_s=60), group="unit"),
    "deviation": BuiltInAlarm(AlarmAttributes(on_delay_s=5, off_delay_s=2), group="speed"),
    "analog_out_of_limits": BuiltInAlarm(AlarmAttributes(on_delay_s=5, off_delay_s=5), group="speed"),
    "port_lost": BuiltInAlarm(group="bus"),
    "no_unit_responds": BuiltInAlarm(AlarmAttributes(on_delay_s=3, off_delay_s=5), group="cable"),
    "worker_lost": BuiltInAlarm(AlarmAttributes(on_delay_s=2)),
    "second_master": BuiltInAlarm(AlarmAttributes(off_delay_s=60), group="bus"),
    "wire_overloaded": BuiltInAlarm(AlarmAttributes(on_delay_s=60, off_delay_s=60), group="unit"),
    "control_left": BuiltInAlarm(AlarmAttributes(off_delay_s=5)),
    "history_degraded": BuiltInAlarm(AlarmAttributes(on_delay_s=5)),
    "audit_degraded": BuiltInAlarm(),
    "disk_low": BuiltInAlarm(AlarmAttributes(on_delay_s=5)),
    "notification_failed": BuiltInAlarm(),
    "clock_stepped": BuiltInAlarm(AlarmAttributes(off_delay_s=60)),
    "certificate_expiring": BuiltInAlarm(),
    "token_expiring": BuiltInAlarm(),
}


def built_in(
    code: BuiltIn, bus: str | None, unit: int | None = None, tuning: BuiltInTuning = NOT_TUNED
) -> AlarmDefinition:
    """The definition of a built-in alarm at its place."""
    row, condition = BUILT_IN[code], CONDITIONS[code]
    record = Rationalization(
        Message(f"alarm_{code}_cause"),
        Message(f"alarm_{code}_consequence"),
        Message(f"alarm_{code}_response"),
        condition.severity,
        condition.time_to_respond,
    )
    return AlarmDefinition(
        key=key_of(bus, unit, code),
        code=code,
        name=Message(f"alarm_{code}"),
        bus=bus,
        unit=unit,
        priority=record.priority,
        record=record,
        attributes=_tuned(row.attributes, tuning),
        group=row.group,
    )


def _tuned(attributes: AlarmAttributes, tuning: BuiltInTuning) -> AlarmAttributes:
    on_delay_s, off_delay_s = tuning.on_delay_s, tuning.off_delay_s
    return replace(
        attributes,
        on_delay_s=attributes.on_delay_s if on_delay_s is None else on_delay_s,
        off_delay_s=attributes.off_delay_s if off_delay_s is None else off_delay_s,
    )

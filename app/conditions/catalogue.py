"""The abnormal conditions as data: how severe each is, and how soon a person has to respond."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.built_in_settings import BuiltIn
from app.conditions.priority import MATRIX, AlarmPriority, Consequence, TimeToRespond

UnalarmedCondition = Literal["run_off", "link_stale", "unit_unknown", "no_unit_yet", "blocked"]
"""Abnormal, and no alarm: a person caused it, it ends within seconds, or another condition has the alarm."""
ConditionCode = BuiltIn | UnalarmedCondition


@dataclass(frozen=True, slots=True)
class Condition:
    """One row. Its priority is the same on every surface."""

    severity: Consequence
    time_to_respond: TimeToRespond

    @property
    def priority(self) -> AlarmPriority:
        """By the matrix."""
        return MATRIX[self.severity, self.time_to_respond]


CONDITIONS: dict[ConditionCode, Condition] = {
    "unit_offline": Condition("major", "minutes"),
    "link_degraded": Condition("minor", "shift"),
    "estop_active": Condition("severe", "minutes"),
    "not_at_speed": Condition("major", "minutes"),
    "running_without_run": Condition("severe", "minutes"),
    "ratio_out_of_limits": Condition("major", "half_hour"),
    "not_in_remote": Condition("minor", "half_hour"),
    "parameter_drift": Condition("major", "shift"),
    "duplicate_address": Condition("severe", "half_hour"),
    "staged_left": Condition("major", "half_hour"),
    "deviation": Condition("major", "minutes"),
    "analog_out_of_limits": Condition("major", "half_hour"),
    "port_lost": Condition("severe", "minutes"),
    "no_unit_responds": Condition("severe", "minutes"),
    "worker_lost": Condition("severe", "minutes"),
    "second_master": Condition("severe", "half_hour"),
    "wire_overloaded": Condition("minor", "shift"),
    "control_left": Condition("minor", "half_hour"),
    "history_degraded": Condition("major", "half_hour"),
    "audit_degraded": Condition("major", "shift"),
    "disk_low": Condition("major", "shift"),
    "notification_failed": Condition("severe", "half_hour"),
    "clock_stepped": Condition("major", "shift"),
    "certificate_expiring": Condition("major", "shift"),
    "token_expiring": Condition("major", "shift"),
    "run_off": Condition("major", "minutes"),
    "link_stale": Condition("minor", "half_hour"),
    "unit_unknown": Condition("minor", "shift"),
    "no_unit_yet": Condition("minor", "shift"),
    "blocked": Condition("minor", "shift"),
}

"""What people do with parameter sets and restores."""

from __future__ import annotations

from app.core.web.admission.access import Role
from app.line.commands.catalogue import WRITE_PARAMETER
from app.people.audit.acts import Act

SAVE = Act("save_parameter_set", Role.ENGINEER, "parameter_set", "event_set_taken")
MARK_GOLDEN = Act("mark_golden_set", Role.ENGINEER, "parameter_set", "event_set_golden")
EXPORT_SECRET = Act("export_secret", Role.ENGINEER, "secret", "event_secret_exported")
SCHEDULE = Act("set_save_schedule", Role.ENGINEER, "parameter_set", "event_sets_scheduled")
END_SCHEDULE = Act("end_save_schedule", Role.ENGINEER, "parameter_set", "event_sets_not_scheduled")

PLAN = Act("plan_restore", WRITE_PARAMETER.role, "restore", "event_restored")
START = Act("start_restore", WRITE_PARAMETER.role, "restore", "event_restored")
CANCEL = Act("cancel_restore", WRITE_PARAMETER.role, "restore", "event_restored")
"""A restore writes parameters, whose role it needs; it is recorded once, when it has ended."""

ACTS = (SAVE, MARK_GOLDEN, EXPORT_SECRET, SCHEDULE, END_SCHEDULE, PLAN, START, CANCEL)

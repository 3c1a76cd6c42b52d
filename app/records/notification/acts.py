"""What people do with notification."""

from __future__ import annotations

from app.core.web.admission.access import Role
from app.people.audit.acts import Act

BEGIN_MAINTENANCE = Act("begin_maintenance", Role.ENGINEER, "notification", "event_maintenance_begun")
END_MAINTENANCE = Act("end_maintenance", Role.ENGINEER, "notification", "event_maintenance_ended")
SEND_TEST = Act("send_test_notification", Role.ENGINEER, "notification", "event_notification_delivered")
"""Recorded as every message is: by the server, once it is delivered or not."""
ACTS = (BEGIN_MAINTENANCE, END_MAINTENANCE, SEND_TEST)

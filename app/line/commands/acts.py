"""What people do with the limits and the block of a unit, with commands to a bus and with its control."""

from __future__ import annotations

from app.core.web.admission.access import Role
from app.people.audit.acts import Act

SET_LIMITS = Act("set_speed_limits", Role.ENGINEER, "limits", "event_limits_changed")
BLOCK = Act("block_commands", Role.OPERATOR, "block", "event_unit_blocked")
UNBLOCK = Act("unblock_commands", Role.OPERATOR, "block", "event_block_lifted")
SET_READ_ONLY = Act("set_read_only", Role.ADMIN, "block", "event_read_only_set")
END_READ_ONLY = Act("end_read_only", Role.ADMIN, "block", "event_read_only_ended")
TAKE_CONTROL = Act("take_control", Role.OPERATOR, "control", "event_control_taken")
HAND_OVER_CONTROL = Act("hand_over_control", Role.OPERATOR, "control", "event_control_handed_over")
FORCE_CONTROL = Act("force_control", Role.ADMIN, "control", "event_control_handed_over")
"""Handing over what another user holds."""
RELEASE_CONTROL = Act("release_control", Role.OPERATOR, "control", "event_control_given_back", counted=False)
REQUEST_CONTROL = Act("request_control", Role.OPERATOR, "control", "event_control_requested")
GRANT_CONTROL = Act("grant_control", Role.OPERATOR, "control", "event_control_handed_over")
"""Handing over to the account that has requested control."""
END_CONTROL_REQUEST = Act("end_control_request", Role.OPERATOR, "control", "event_control_request_ended")
"""Declining a request, by the holder, or withdrawing it."""
ACTS = (
    *(SET_LIMITS, BLOCK, UNBLOCK, SET_READ_ONLY, END_READ_ONLY),
    *(TAKE_CONTROL, HAND_OVER_CONTROL, FORCE_CONTROL, RELEASE_CONTROL),
    *(REQUEST_CONTROL, GRANT_CONTROL, END_CONTROL_REQUEST),
)

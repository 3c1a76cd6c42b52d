"""What people do with saved views of the trends page that everyone sees."""

from __future__ import annotations

from app.audit.acts import Act
from app.web.admission.access import Role

SHARE = Act("share_view", Role.OPERATOR, "configuration", "event_view_shared")
DELETE_SHARED = Act("delete_shared_view", Role.ENGINEER, "configuration", "event_view_deleted")
"""Of another person; each deletes their own."""
ACTS = (SHARE, DELETE_SHARED)

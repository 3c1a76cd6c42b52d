"""What people do with accounts: an admin with those of all, everyone with the own one."""

from __future__ import annotations

from app.core.web.admission.access import Role
from app.people.audit.acts import Act

ADD_USER = Act("add_user", Role.ADMIN, "user", "event_user_added")
ADD_FIRST_ADMIN = Act("add_first_admin", Role.ADMIN, "user", "event_first_admin_added")
ADD_PANEL = Act("add_panel", Role.ADMIN, "user", "event_panel_added")
SET_ROLE = Act("set_role", Role.ADMIN, "user", "event_role_changed")
DISABLE_USER = Act("disable_user", Role.ADMIN, "user", "event_user_refused")
ENABLE_USER = Act("enable_user", Role.ADMIN, "user", "event_user_admitted")
SET_PASSWORD = Act("set_password", Role.ADMIN, "user", "event_password_changed")
REMOVE_USER = Act("remove_user", Role.ADMIN, "user", "event_user_removed")
CREATE_TOKEN = Act("create_token", Role.ADMIN, "token", "event_token_created")
CREATE_WORKER_TOKEN = Act("create_worker_token", Role.ADMIN, "token", "event_token_of_bus_created")
REVOKE_TOKEN = Act("revoke_token", Role.ADMIN, "token", "event_token_revoked")
CHANGE_OWN_PASSWORD = Act("change_own_password", Role.VIEWER, "user", "event_password_changed")
LOG_OUT = Act("log_out", Role.VIEWER, "logout", "event_signed_out")

_OF_USERS = (ADD_USER, ADD_PANEL, SET_ROLE, DISABLE_USER, ENABLE_USER, SET_PASSWORD, REMOVE_USER)
_OF_TOKENS = (CREATE_TOKEN, CREATE_WORKER_TOKEN, REVOKE_TOKEN)
ACTS = (*_OF_USERS, *_OF_TOKENS, CHANGE_OWN_PASSWORD, LOG_OUT)

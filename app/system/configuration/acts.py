"""What people do with the configuration file."""

from __future__ import annotations

from app.core.web.admission.access import Role
from app.people.audit.acts import Act

CHANGE = Act("change_configuration", Role.ENGINEER, "configuration", "event_configuration_edited")
CHANGE_MAIL = Act("change_mail_server", Role.ADMIN, "configuration", "event_configuration_edited")
"""The server sends its password to the mail server that is named here, and the links in its mails lead
people to the address of the dashboard."""
CHANGE_PORTS = Act("change_ports", Role.ADMIN, "configuration", "event_configuration_edited")
"""The server opens the devices and hosts that are named here."""
ROLL_BACK = Act("roll_back_configuration", Role.ADMIN, "configuration", "event_configuration_rolled_back")
"""It may change everything, also what only the file has."""
RESTART = Act("restart_server", Role.ADMIN, "server", "event_restart_requested")
"""For a few seconds no drive of the server is monitored."""
ACTS = (CHANGE, CHANGE_MAIL, CHANGE_PORTS, ROLL_BACK, RESTART)

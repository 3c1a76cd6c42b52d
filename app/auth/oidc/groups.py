"""What the claims of an ID token make of a person: a name and, by the groups, a role. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from app.auth import rules
from app.auth.settings import OidcSettings
from app.web.admission.access import PEOPLE_ROLES, Role
from bus.errors import CallerError
from bus.text import composed

MAX_GROUPS = 5000


def name_of(claims: Mapping[str, Any], settings: OidcSettings) -> str:
    """The name of a new user with these claims; empty where it is none that a user may have."""
    name = claims.get(settings.name_claim)
    if not isinstance(name, str):
        return ""
    with suppress(CallerError):
        rules.check_name(name := composed(name[: 4 * rules.MAX_NAME + 1]))
        return name
    return ""


def role_of(claims: Mapping[str, Any], settings: OidcSettings) -> Role | None:
    """The highest role of the groups; None where no group has one."""
    found = claims.get(settings.groups_claim)
    groups = [found] if isinstance(found, str) else found if isinstance(found, list) else []
    roles = {
        Role(settings.roles[each])
        for each in groups[:MAX_GROUPS]
        if isinstance(each, str) and each in settings.roles
    }
    return max(roles, key=PEOPLE_ROLES.index, default=None)

"""The author of what a test changes of accounts."""

from __future__ import annotations

from typing import Any

from app.core.web.access import Person, Role

BY: dict[str, Any] = {"by": Person("test", Role.ADMIN, "console", address="test")}
"""For every change of :class:`app.people.auth.accounts.Accounts`."""

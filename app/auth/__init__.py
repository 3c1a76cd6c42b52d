"""Who: users, roles, sessions, tokens. Everything is refused that is not allowed by name."""

from __future__ import annotations

from app.web.access import Admin, Engineer, Operator, Person, Role, Viewer, Worker, public, requires

__all__ = ["Admin", "Engineer", "Operator", "Person", "Role", "Viewer", "Worker", "public", "requires"]

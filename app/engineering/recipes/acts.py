"""What people do with a recipe."""

from __future__ import annotations

from app.core.web.admission.access import Role
from app.line.commands.catalogue import SET_LINE
from app.people.audit.acts import Act

SAVE = Act("save_recipe", Role.ENGINEER, "recipe", "event_recipe_saved")
DELETE = Act("delete_recipe", Role.ENGINEER, "recipe", "event_recipe_retired")
LOAD = Act("load_recipe", SET_LINE.role, "recipe", "event_recipe_loaded")
"""A command to the units, whose role it needs; this is recorded when it is verified."""
ACTS = (SAVE, DELETE, LOAD)

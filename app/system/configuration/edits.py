"""What may be done with a table of the file, as a change of its text."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping

from app.errors import Problem
from app.people.audit.acts import Act
from app.system.configuration.acts import CHANGE, CHANGE_MAIL
from app.system.configuration.document import Edit, moved_up, with_values, without
from app.system.configuration.tables import TablePlace, changes_of
from bus.messages import Message


def act_on(place: TablePlace) -> Act:
    """What a person must be permitted to do."""
    return CHANGE_MAIL if place.form.kind in ("notify", "smtp") else CHANGE


def edit_of(place: TablePlace, kind: str, texts: Mapping[str, str]) -> Edit:
    """``kind``: ``change`` sets keys to what was typed, ``remove`` removes the table, ``up`` exchanges it
    with the one before it. Raises Problem 422 for what cannot be done with the table."""
    if kind == "change":
        return lambda text: _changed(text, place, texts)
    if kind == "remove" and place.form.is_listed:
        return lambda text: without(text, place.path)
    if kind == "up" and place.form.kind == "unit":
        return lambda text: moved_up(text, place.path)
    raise Problem(422, "invalid", Message.of("configuration_no_such_change", name=place.name))


def _changed(text: str, place: TablePlace, texts: Mapping[str, str]) -> str:
    changes = changes_of(place, tomllib.loads(text), texts)
    return with_values(text, place.path, changes) if changes else text

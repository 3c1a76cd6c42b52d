"""Fields in groups, of which only those that differ go on: to pages and to ``GET /stream`` alike. Pure."""

from __future__ import annotations

from typing import TypeVar

from app.live.screen.fields import Fields

Groups = dict[str, Fields]
K = TypeVar("K")


def put_fields(shown: dict[K, Fields], group: K, fields: Fields) -> dict[K, Fields]:
    """Show ``fields`` in ``group``; return those that differ from before, and no group where none does."""
    before = shown.setdefault(group, {})
    changed = {name: value for name, value in fields.items() if before.get(name) != value}
    before.update(changed)
    return {group: changed} if changed else {}


def merge_groups(groups: Groups, *later: Groups) -> Groups:
    """Return ``groups``, with the fields of each that is ``later`` in the place of earlier ones."""
    for each in later:
        for group, fields in each.items():
            groups.setdefault(group, {}).update(fields)
    return groups

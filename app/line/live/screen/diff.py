"""Fields in groups, of which only those that differ go on: to pages and to ``GET /stream`` alike. Pure."""

from __future__ import annotations

from typing import Any, TypeVar

from app.line.live.screen.fields import Fields

Groups = dict[str, Fields]
K = TypeVar("K")


class FlatFields:
    """The fields of groups by ``group.field``, as templates read them. Not a dictionary: for a long line it
    would be a megabyte for each page that opens."""

    def __init__(self, groups: Groups) -> None:
        self._groups = groups

    def __getitem__(self, key: str) -> Any:
        group, _, name = key.rpartition(".")
        return self._groups[group][name]

    def get(self, key: str, default: Any = None) -> Any:
        """The field, or ``default`` where there is none."""
        group, _, name = key.rpartition(".")
        return self._groups.get(group, {}).get(name, default)


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

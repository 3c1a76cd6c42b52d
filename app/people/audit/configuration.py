"""Finds what changed in the configuration since the server ran last, so that it can be an event."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from app.core.database.files import write_file

FILE = "configuration.json"
"""The configuration that the server ran with last; beside the store."""


def flat(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield every leaf with its path: ``bus.dry-end.unit.1.name``. Elements go by their id or name."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from flat(inner, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from flat(inner, f"{path}.{_name(inner, index)}")
    else:
        yield path, json.dumps(value, ensure_ascii=False)


def _name(element: Any, index: int) -> str:
    named = element if isinstance(element, Mapping) else {}
    return str(named.get("id", named.get("name", index)))


def differences(before: Any, now: Any) -> list[str]:
    """Return each leaf that is new, gone or other than it was, as a phrase."""
    old, new = dict(flat(before)), dict(flat(now))
    return [
        f"{path}: {old.get(path, 'nothing')} → {new.get(path, 'nothing')}"
        for path in sorted(old.keys() | new.keys())
        if old.get(path) != new.get(path)
    ]


def change_since_last(folder: Path, now: dict[str, Any]) -> str:
    """Return the changes in one text, empty when there are none; store the configuration for the next
    time."""
    file = folder / FILE
    try:
        before = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        before = None
    write_file(file, json.dumps(now, ensure_ascii=False, indent=1).encode())
    if before is None:
        return ""
    return "; ".join(differences(before, now))

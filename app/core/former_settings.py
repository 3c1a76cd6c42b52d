"""Keys of lineside.toml from version 0.2, which are ignored with a warning, so that no line stops at an
upgrade. Only a configuration whose data is in a database is refused."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from bus.configuration import KeyPath, LineNumbers
from bus.messages import Message
from bus.settings import FORMER_KEYS_OF_BUS
from bus.validation import setting_fault

FORMER_KEYS = {("store",), ("history", "spool_mb"), ("server", "id"), ("server", "home"), ("server", "url")}
"""The paths of former keys and tables."""
FORMER_ALARMS = ("store_unavailable", "break_glass_used")
"""Codes of former alarms; settings of them in a ``[[built_in_alarm]]`` are ignored."""
BREAK_GLASS = "break-glass.json"
"""The file of accounts that signed in only while the database of the site was away; none does so now."""


def former_keys(data: Mapping[str, Any]) -> list[KeyPath]:
    """Return the paths of the keys of a configuration that are ignored."""
    found: list[KeyPath] = [path for path in FORMER_KEYS if _has(data, path)]
    for number, bus in enumerate(data.get("bus", ())):
        found += [("bus", number, key) for key in FORMER_KEYS_OF_BUS if key in bus]
    for number, alarm in enumerate(data.get("built_in_alarm", ())):
        if alarm["code"] in FORMER_ALARMS:
            found.append(("built_in_alarm", number, "code"))
    return sorted(found, key=str)


def former_notices(text: str, file: str, folder: Path) -> list[Message]:
    """Return a notice for each part of a configuration and of its data folder that an earlier version used
    and that sets nothing now."""
    lines = LineNumbers(text)
    notices = [
        Message.of("ignored_key", file=file, line=lines.line_of(path), key=_name(path))
        for path in former_keys(tomllib.loads(text))
    ]
    # Whether the folder can be used at all is checked by `check` and at the start.
    with suppress(OSError):
        if (accounts := folder / BREAK_GLASS).exists():
            notices.append(Message.of("break_glass_of_former_version", file=str(accounts)))
    return notices


def _name(path: KeyPath) -> str:
    """Return the name of a key with those of its tables, as TOML writes it."""
    return ".".join(step for step in path if isinstance(step, str))


def without_former_keys(data: object) -> object:
    """Return the configuration without the keys that are ignored. Raise PydanticCustomError if its data is
    in a database: a server that began beside it would look like one that has lost everything."""
    if not isinstance(data, dict):
        return data
    if isinstance(store := data.get("store"), dict) and store.get("url"):
        raise setting_fault(Message("setting_store_url"), "store", "url")
    for *tables, key in FORMER_KEYS:
        if _has(data, (*tables, key)):
            data = _without(data, tables, key)
    return data


def _has(data: Mapping[str, Any], path: tuple[str, ...]) -> bool:
    key, *more = path
    return key in data and (not more or (isinstance(data[key], dict) and _has(data[key], tuple(more))))


def _without(data: Mapping[str, Any], tables: list[str], key: str) -> dict[str, Any]:
    if not tables:
        return {name: value for name, value in data.items() if name != key}
    return {**data, tables[0]: _without(data[tables[0]], tables[1:], key)}

"""The SQL of features, which SQLite takes as it is, in the words of PostgreSQL. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

MAX_STATEMENTS = 2048
RESERVED = frozenset({"only"})
"""Names of columns that are words of PostgreSQL."""
_TOKEN = re.compile(
    r"(?P<text>'(?:[^']|'')*'|\"(?:[^\"]|\"\")*\")"
    r"|(?P<comment>--[^\n]*)"
    r"|(?P<index>\s*\bINDEXED\s+BY\s+\w+)"
    r"|(?P<same>\bIS\s+(?P<negated>NOT\s+)?(?=[?:]))"
    r"|\?(?P<number>\d*)"
    r"|(?<!:):(?P<name>[A-Za-z_]\w*)"
    r"|(?P<word>[A-Za-z_]\w*)",
    re.IGNORECASE,
)
_WORDS = {"LIKE": "ILIKE"}
"""ILIKE ignores the case of ASCII letters in a column of collation "C", as LIKE of SQLite does."""


@dataclass(frozen=True, slots=True)
class Statement:
    """A statement with numbered placeholders. ``names``: of the values in their order, where it has names."""

    sql: str
    names: tuple[str, ...] = ()

    def values(self, parameters: Sequence[Any] | Mapping[str, Any]) -> Sequence[Any]:
        """The values in the order of their numbers."""
        if isinstance(parameters, Mapping):
            return [parameters[name] for name in self.names]
        return parameters


@lru_cache(MAX_STATEMENTS)
def translated(sql: str) -> Statement:
    """A statement of a feature for PostgreSQL."""
    names: dict[str, int] = {}
    count = 0

    def replace(match: re.Match[str]) -> str:
        nonlocal count
        if match["text"] or match["comment"]:
            return match[0]
        if match["index"]:
            return ""
        if match["same"]:
            return f"IS {'' if match['negated'] else 'NOT '}DISTINCT FROM "
        if match["name"]:
            return f"${names.setdefault(match['name'], len(names) + 1)}"
        if match["word"]:
            word = match["word"]
            return f'"{word}"' if word in RESERVED else _WORDS.get(word.upper(), word)
        count += 1
        return f"${match['number'] or count}"

    return Statement(_TOKEN.sub(replace, sql), tuple(names))

"""What a frame says, clause by clause: a page says each in its own language, a log joins them in English."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Annotated

from msgspec import Meta, Struct

_NAME = re.compile(r"\{(\w+)\}")
Words = Annotated[str, Meta(max_length=300)]
LONGEST = 1_000
"""Of a clause that is filled in, and of a meaning."""


class Clause(Struct, frozen=True, array_like=True):
    """``text``: English, with names in braces; ``values``: what stands for them, a number or English words;
    ``then``: what stands between this clause and the next."""

    text: Words
    values: Annotated[Mapping[Words, int | Words], Meta(max_length=20)] = {}
    then: Words = ""


def in_english(clauses: Iterable[Clause]) -> str:
    """The whole meaning, as the API and the logs have it."""
    return "".join(filled(clause.text, clause.values) + clause.then for clause in clauses)[:LONGEST]


def filled(text: str, values: Mapping[str, int | str]) -> str:
    """``text`` with each ``{name}`` replaced by its value, at most :data:`LONGEST` characters.

    What comes from another process is never a format string: that could reach into objects
    (``{a.__class__}``) and pad without bound (``{a:>999999999}``).
    """
    return _NAME.sub(lambda found: str(values.get(found[1], found[0])), text)[:LONGEST]

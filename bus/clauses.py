"""What a frame says, clause by clause: a page says each in its own language, a log joins them in English."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msgspec import Struct


class Clause(Struct, frozen=True, array_like=True):
    """``text``: English, with names in braces; ``values``: what stands for them, a number or English words;
    ``then``: what stands between this clause and the next."""

    text: str
    values: Mapping[str, int | str] = {}
    then: str = ""


def in_english(clauses: Iterable[Clause]) -> str:
    """The whole meaning, as the API and the logs have it."""
    return "".join(_said(clause) + clause.then for clause in clauses)


def _said(clause: Clause) -> str:
    return clause.text.format(**clause.values) if clause.values else clause.text

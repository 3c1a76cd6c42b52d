"""Which names a typed text finds, and which of them first. Pure."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence

EXACT, BEGINS, WORD_BEGINS, WITHIN = range(4)
"""How a word is found in a name, the best first."""
_WORD = re.compile(r"\w+")


def folded(text: str) -> str:
    """Without case and accents, so that "kuhl" finds "Kühlwalze"."""
    apart = unicodedata.normalize("NFKD", text.casefold())
    return "".join(letter for letter in apart if not unicodedata.combining(letter))


def words_of(typed: str) -> list[str]:
    """The words of a query, folded, each once."""
    return list(dict.fromkeys(_WORD.findall(folded(typed))))


def rank(words: Sequence[str], names: Iterable[str]) -> int | None:
    """How well all ``words`` are found in ``names``, 0 the best; None where one is in none of them. A number
    is found as a number: "2" is not in "12"."""
    among = [folded(name) for name in names if name]
    total = 0
    for word in words:
        found = [how for name in among if (how := _found(word, name)) is not None]
        if not found:
            return None
        total += min(found)
    return total


def missing(words: Iterable[str], names: Sequence[str]) -> list[str]:
    """The words that are in none of ``names``."""
    return [word for word in words if rank([word], names) is None]


def _found(word: str, name: str) -> int | None:
    if name == word:
        return EXACT
    if word.isdigit():
        return WORD_BEGINS if word in _WORD.findall(name) else None
    if name.startswith(word):
        return BEGINS
    if any(each.startswith(word) for each in _WORD.findall(name)):
        return WORD_BEGINS
    return WITHIN if word in name else None

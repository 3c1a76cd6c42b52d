"""Finished sentences in another language, found by the pattern that they were built from.

A rule, a unit's worker or the log of events says a whole sentence with numbers and names in it, in
English: it also stands in the API and in the log, and may come from another process or from last year.
A page finds the pattern again, and what stood in its braces.
"""

from __future__ import annotations

import re
import string
from collections.abc import Callable, Mapping

MOST_REMEMBERED = 2000
LONGEST = 400
"""Characters of a sentence that is looked for: the patterns backtrack, and a stored text may be hostile."""
DEEPEST = 12
"""So many sentences in one another; what is in the innermost one stays as it is."""
AS_TYPED = frozenset({"called", "typed"})
"""In a pattern, the braces of a name that people have given and of what they have written."""

NARROW = {"lowest": r"\S", "highest": r"\S", "others": r"[\d, ]", "unit": "[^;:]", "units": "[^;:]"}
"""Of what signs a number or a list of numbers can be, lest one pattern swallows the half of two sentences."""


class Sentences:
    """``{"unit {n} did not answer": "Regler {n} antwortet nicht"}``; the first pattern that fits is taken."""

    def __init__(self, patterns: Mapping[str, str] | None = None) -> None:
        self._patterns = [(_expression(text), said) for text, said in (patterns or {}).items()]
        self._known: dict[str, str] = {}
        self._depth = 0

    def say(self, sentence: str, t: Callable[[str], str]) -> str:
        """The sentence in this language, each value in it by ``t``; as it is where no pattern fits."""
        known = self._known.get(sentence)
        if known is None:
            if len(self._known) >= MOST_REMEMBERED:
                self._known.clear()
            known = self._known[sentence] = self._find(sentence, t)
        return known

    def _find(self, sentence: str, t: Callable[[str], str]) -> str:
        if " " not in sentence or len(sentence) > LONGEST or self._depth == DEEPEST:
            return sentence
        self._depth += 1
        try:
            for expression, said in self._patterns:
                found = expression.fullmatch(sentence)
                if found:
                    values = found.groupdict().items()
                    return said.format(**{name: _value(name, value, t) for name, value in values})
        finally:
            self._depth -= 1
        return sentence


def _value(name: str, value: str, t: Callable[[str], str]) -> str:
    """What people have called somebody or something, or have typed, is said as it is: a user may be called
    ``operator``, and a recipe ``at speed``. ``who`` may also be a sentence of the program's own."""
    if name in AS_TYPED or (name == "who" and " " not in value):
        return value
    return t(value)


def _expression(pattern: str) -> re.Pattern[str]:
    parts = (
        re.escape(literal) + (f"(?P<{name}>{NARROW.get(name, '.')}+?)" if name else "")
        for literal, name, _, _ in string.Formatter().parse(pattern)
    )
    return re.compile("".join(parts), re.DOTALL)

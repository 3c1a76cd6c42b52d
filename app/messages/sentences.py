"""Finished sentences in another language, found by the pattern that they were built from.

A rule, a unit's worker or the event log gives a finished English sentence with numbers and names in it: the
same sentence is in the API and in the log, and may be of another process or of last year. A page finds the
pattern again, and what was filled into its braces. Request text is never looked up (`app.errors.Problem`);
the bounds here hold for any text nonetheless, because a stored sentence may quote what somebody typed.
"""

from __future__ import annotations

import re
import string
from collections.abc import Callable, Mapping
from dataclasses import dataclass

MOST_REMEMBERED = 2000
LONGEST = 300
"""Characters of a sentence that is looked up; a longer one stays English."""
DEEPEST = 12
"""Sentences inside sentences: each clause of "unit 1: …; unit 2: …" is one inside the one before it."""
AS_TYPED = frozenset({"called", "typed"})
"""In a pattern, the braces of a name that people have given and of what they have written."""

NARROW = {"lowest": r"\S", "highest": r"\S", "others": r"[\d, ]", "unit": "[^;:]", "units": "[^;:]"}
"""Of what signs a number or a list of numbers can be, lest one pattern swallows the half of two sentences."""


class Sentences:
    """``{"unit {n} did not answer": "Regler {n} antwortet nicht"}``; the first pattern that fits is taken.

    ``texts`` translates the values that are fixed texts themselves.
    """

    def __init__(self, patterns: Mapping[str, str] | None = None, texts: Callable[[str], str] = str) -> None:
        self._patterns = [Pattern.of(text, said) for text, said in (patterns or {}).items()]
        self._texts = texts
        self._known: dict[str, str] = {}

    def say(self, sentence: str) -> str:
        """The sentence in this language; as it is where no pattern fits or it is too long to be looked up."""
        if len(sentence) > LONGEST:
            return sentence
        known = self._known.get(sentence)
        if known is None:
            if len(self._known) >= MOST_REMEMBERED:
                self._known.clear()
            known = self._known[sentence] = self._find(sentence, DEEPEST)
        return known

    def _find(self, sentence: str, deepest: int) -> str:
        if (translated := self._texts(sentence)) != sentence:
            return translated
        if not deepest or " " not in sentence:
            return sentence
        for pattern in self._patterns:
            values = pattern.values_in(sentence)
            if values is not None:
                filled = {name: self._value(name, value, deepest - 1) for name, value in values.items()}
                return pattern.said.format(**filled)
        return sentence

    def _value(self, name: str, value: str, deepest: int) -> str:
        """A name that people have given and what they have typed stay as they are: a user may be called
        ``operator``, and a recipe ``at speed``. ``who`` may also be a sentence of the program's own."""
        if name in AS_TYPED or (name == "who" and " " not in value):
            return value
        return self._find(value, deepest)


@dataclass(frozen=True, slots=True)
class Pattern:
    """A sentence with braces, and how it is ``said`` in the other language."""

    said: str
    start: str
    """The literal before the first brace."""
    literal: str
    """The longest of the literals."""
    expression: re.Pattern[str]

    @classmethod
    def of(cls, text: str, said: str) -> Pattern:
        """Each brace with the literal after it is an atomic group: it ends at the first place of the literal
        and never at another. Without that, a text that almost fits a pattern of k braces is tried at n^k
        places."""
        parsed = list(string.Formatter().parse(text))
        names = [name for _, name, _, _ in parsed if name is not None]
        start, *ends = [literal for literal, _, _, _ in parsed] + [""] * (len(names) == len(parsed))
        closed = [*map(re.escape, ends[:-1]), *(re.escape(end) + r"\Z" for end in ends[-1:])]
        steps = (
            f"(?>(?P<{name}>{NARROW.get(name, '.')}+?){end})" for name, end in zip(names, closed, strict=True)
        )
        expression = re.compile(re.escape(start) + "".join(steps), re.DOTALL)
        return cls(said, start, max(ends, key=len, default=""), expression)

    def values_in(self, sentence: str) -> dict[str, str] | None:
        """What the sentence has in the braces; None where it is not of this pattern."""
        if not sentence.startswith(self.start) or self.literal not in sentence:
            return None
        found = self.expression.fullmatch(sentence)
        return found.groupdict() if found else None

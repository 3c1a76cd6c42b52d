"""Where the texts of one language come from, and the one of English."""

from __future__ import annotations

from typing import Protocol

from bus.messages.texts import TEXTS, Plural


class Catalog(Protocol):
    """The texts of one language."""

    @property
    def point(self) -> str:
        """The decimal sign."""

    def template(self, code: str, n: object) -> str | None:
        """The text of a message, names in braces, for ``n`` things where it counts; None: no such code."""

    def term(self, text: str) -> str:
        """A fixed word of the program in this language."""


class EnglishCatalog:
    """The English texts, for the log, the command line and ``detail`` of the API."""

    point = "."

    def template(self, code: str, n: object) -> str | None:
        text = TEXTS.get(code)
        if isinstance(text, Plural):
            return text.one if n == 1 else text.many
        return text

    def term(self, text: str) -> str:
        return text


ENGLISH = EnglishCatalog()

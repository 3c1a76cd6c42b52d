"""The texts of a language, and those in English, from the ``texts.toml`` beside the code that uses them."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple, Protocol, TypeAlias


class Plural(NamedTuple):
    """A text with a number of things: ``one`` where the message's ``n`` is 1, else ``many``."""

    one: str
    many: str


EnglishText: TypeAlias = str | Plural
TEXTS: dict[str, EnglishText] = {}
"""By code: of the bus, and of the app where that is imported."""
PARAMETER_NAMES: dict[int, str] = {}
"""By number: of the catalogue, where that is imported. Each language has its own in its catalog."""


def add_texts(package: Path) -> None:
    """Add the texts of a package and its subpackages. Raises ValueError for a code that is there already."""
    for path in sorted(package.rglob("texts.toml")):
        with path.open("rb") as file:
            found = tomllib.load(file)
        if twice := found.keys() & TEXTS.keys():
            raise ValueError(f"{path}: {', '.join(sorted(twice))} is also in another texts.toml")
        for code, text in found.items():
            TEXTS[code] = text if isinstance(text, str) else Plural(**text)


add_texts(Path(__file__).parents[1])


class Catalog(Protocol):
    """The texts of one language."""

    @property
    def point(self) -> str:
        """The decimal sign."""

    def template(self, code: str, n: object) -> str | None:
        """The text of a message, names in braces, for ``n`` things where it counts; None: no such code."""

    def term(self, text: str) -> str:
        """A fixed word of the program in this language."""

    def time(self, text: str) -> str:
        """A date or a time in ISO 8601 as readers of this language write it."""

    def isolated(self, text: str) -> str:
        """What a person wrote, such as a name, as it is put into a text: letters from right to left turn
        what is beside them on a screen. For all that programs read, as it is."""


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

    def time(self, text: str) -> str:
        return text

    def isolated(self, text: str) -> str:
        return text


ENGLISH = EnglishCatalog()

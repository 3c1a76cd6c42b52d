"""The English text of every message, from the file ``texts.toml`` beside the code that uses it."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple, TypeAlias


class Plural(NamedTuple):
    """A text with a number of things: ``one`` where the message's ``n`` is 1, else ``many``."""

    one: str
    many: str


EnglishText: TypeAlias = str | Plural
TEXTS: dict[str, EnglishText] = {}
"""By code: of the bus, and of the app where that is imported."""


def add_texts(package: Path) -> None:
    """Add the texts of a package and its subpackages. Raises ValueError for a code that is there already."""
    for path in sorted(package.rglob("texts.toml")):
        with path.open("rb") as file:
            found = tomllib.load(file)
        if twice := found.keys() & TEXTS.keys():
            raise ValueError(f"{path}: {', '.join(sorted(twice))} is also in another texts.toml")
        TEXTS.update({code: _text(of) for code, of in found.items()})


def _text(found: str | dict[str, str]) -> EnglishText:
    return found if isinstance(found, str) else Plural(**found)


add_texts(Path(__file__).parents[1])

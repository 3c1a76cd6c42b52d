"""The languages of the pages: each file ``xx.toml`` beside this one is a language."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from app.web.languages.sentences import Sentences

DEFAULT = "en"
LONGEST_HEADER = 400
"""Characters of Accept-Language that are read; browsers send a dozen tags at most."""


@dataclass(frozen=True)
class Language:
    """One language: its tag, what it calls itself, its locale for numbers and dates, its texts.

    ``sentences`` are for what was built in English before anybody knew who would read it.
    """

    tag: str
    name: str
    locale: str
    texts: dict[str, str] = field(default_factory=dict)
    sentences: Sentences = field(default_factory=Sentences)

    def __str__(self) -> str:
        return self.tag

    def t(self, text: str, /, **values: object) -> str:
        """The text in this language (in English when it is not translated), ``{names}`` filled in."""
        translated = self.texts.get(text)
        if values:
            return (translated or text).format(**values)
        return self.sentences.say(text) if translated is None else translated

    def tn(self, one: str, many: str, n: int, /, **values: object) -> str:
        """The text for a count: ``one`` for exactly one, else ``many``; ``{n}`` in it is the count."""
        return self.t(one if n == 1 else many, n=n, **values)


class Languages:
    """Every language there is a file for."""

    def __init__(self, folder: Path = Path(__file__).parent) -> None:
        self._all = {path.stem: _load(path) for path in sorted(folder.glob("*.toml"))}

    def __iter__(self) -> Iterator[Language]:
        return iter(self._all.values())

    def __contains__(self, tag: object) -> bool:
        return tag in self._all

    def __getitem__(self, tag: str) -> Language:
        """The language, English for a tag there is no file for."""
        return self._all.get(tag) or self._all[DEFAULT]

    def choose(self, wished: str, accept_language: str, otherwise: str) -> Language:
        """The person's own wish, else the browser's (RFC 9110, 12.5.4), else the site's."""
        if wished in self._all:
            return self._all[wished]
        for tag in _by_preference(accept_language):
            if tag in self._all:
                return self._all[tag]
        return self[otherwise]


@cache
def _load(path: Path) -> Language:
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    sentences = Sentences(data.get("sentences"), data["texts"])
    return Language(path.stem, data["name"], data["locale"], data["texts"], sentences)


def _by_preference(accept_language: str) -> list[str]:
    """``de-AT,de;q=0.9,en;q=0.8`` → ``["de-at", "de", "en"]``, each tag followed by its main part."""
    weighed: list[tuple[float, str]] = []
    for part in accept_language[:LONGEST_HEADER].split(","):
        tag, _, weight = part.strip().partition(";q=")
        try:
            weighed.append((float(weight or 1), tag.lower()))
        except ValueError:
            continue
    weighed.sort(key=lambda pair: -pair[0])
    return [each for _, tag in weighed for each in (tag, tag.split("-")[0])]

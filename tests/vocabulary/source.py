"""Words that the glossary replaces in comments, docstrings and names of the source code."""

from __future__ import annotations

import io
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path

from tests.vocabulary import ROOT, words_of

FOLDERS = ("app", "bus", "tests", "benchmarks")
AVOIDED_IN_SOURCE = Path(__file__).parent / "avoided_in_source.txt"
_ENDINGS = ("", "s", "es")
_BEFORE_A_DOCSTRING = (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, None)
_NO_STATEMENT = (tokenize.NL, tokenize.COMMENT)


class AvoidedWords:
    """The words and phrases to search for. Those that end in "is" count in a name, and as the first words of
    a text, where they are used as a name.
    """

    def __init__(self, words: Iterable[str]) -> None:
        endings = [f" {word}{ending} " for word in words for ending in _ENDINGS]
        self._single = {word.strip() for word in endings if word.count(" ") == 2}
        self._phrases = [word for word in endings if word.count(" ") > 2]

    def in_words(self, words: str, *, is_name: bool) -> Iterator[str]:
        """Yield what is found in :func:`words_of` a text or of a name."""
        yield from self._single.intersection(words.split())
        for phrase in self._phrases:
            if phrase in words and (is_name or not phrase.endswith(" is ") or words.startswith(phrase)):
                yield phrase.strip()


def uses(source: str, avoided: AvoidedWords) -> Iterator[tuple[int, str]]:
    """Yield the line and the word of each use. String literals other than docstrings are data."""
    if any(avoided.in_words(words_of(source), is_name=True)):
        for line, text, is_name in _parts(source):
            yield from ((line, word) for word in avoided.in_words(words_of(text), is_name=is_name))


def _parts(source: str) -> Iterator[tuple[int, str, bool]]:
    """Yield the line and the text of each comment, docstring and name, and whether it is a name."""
    before: int | None = None
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    for kind, group in groupby(tokens, lambda token: "#" if token.type in _NO_STATEMENT else token.type):
        run = list(group)
        if kind == "#":
            yield run[0].start[0], " ".join(token.string for token in run), False
            continue
        for token in run:
            if token.type == tokenize.NAME:
                yield token.start[0], token.string, True
            elif token.type == tokenize.STRING and before in _BEFORE_A_DOCSTRING:
                yield token.start[0], token.string, False
            before = token.type


def found(avoided: AvoidedWords) -> list[str]:
    """Return ``file:line: word`` of each use in the repository."""
    return [
        f"{path.relative_to(ROOT)}:{line}: {word}"
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line, word in uses(path.read_text(encoding="utf-8"), avoided)
    ]


def by_folder(places: Iterable[str]) -> Counter[str]:
    """Folder, as ``bus/line`` or ``tests/app``, → number of uses in it."""
    return Counter(map(folder_of, places))


def folder_of(place: str) -> str:
    """Return the first two parts of the path of a place."""
    return "/".join(place.partition(":")[0].split("/")[:2])

"""Words that the glossary replaces in comments, docstrings, names and messages of assertions."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from itertools import groupby

from tests.vocabulary import ROOT, words_of

FOLDERS = ("app", "bus", "tests", "benchmarks")
COMMENTED = ("app", "static/css", "static/js", "templates", "tests/js", "types")
_ENDINGS = ("", "s", "es")
_BEFORE_A_DOCSTRING = (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, None)
_NO_STATEMENT = (tokenize.NL, tokenize.COMMENT)
_COMMENTS = {
    ".css": re.compile(r"/\*.*?\*/", re.DOTALL),
    ".html": re.compile(r"\{#.*?#\}", re.DOTALL),
    ".js": re.compile(r"/\*.*?\*/|(?:(?<!\S)//[^\n]*\s*)+|(?<!\S)test\(\"[^\"]*\"", re.DOTALL),
    ".ts": re.compile(r"/\*.*?\*/|(?:(?<!\S)//[^\n]*\s*)+", re.DOTALL),
    ".sql": re.compile(r"(?:^--[^\n]*\s*)+", re.MULTILINE),
}
"""Suffix of a file → its comments; of JavaScript also the names of tests."""


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
    """Yield the line and the word of each use. String literals are data, other than docstrings and the
    messages of assertions.
    """
    if any(avoided.in_words(words_of(source), is_name=True)):
        for line, text, is_name in (*_parts(source), *_messages(source)):
            yield from ((line, word) for word in avoided.in_words(words_of(text), is_name=is_name))


def uses_in_comments(suffix: str, source: str, avoided: AvoidedWords) -> Iterator[tuple[int, str]]:
    """Yield the line and the word of each use in a comment of a file that is not Python."""
    for comment in _COMMENTS[suffix].finditer(source):
        line = 1 + source.count("\n", 0, comment.start())
        yield from ((line, word) for word in avoided.in_words(words_of(comment[0]), is_name=False))


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


def _messages(source: str) -> Iterator[tuple[int, str, bool]]:
    """Yield the line and the text of the message of each assertion."""
    for statement in ast.walk(ast.parse(source)):
        if isinstance(statement, ast.Assert) and statement.msg is not None:
            texts = (part for part in ast.walk(statement.msg) if isinstance(part, ast.Constant))
            yield from ((part.lineno, str(part.value), False) for part in texts)


def found(avoided: AvoidedWords) -> list[str]:
    """Return ``file:line: word`` of each use in the repository; line 0 is the name of the file."""
    places: list[str] = []
    for path in sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        in_name = [(0, word) for word in avoided.in_words(words_of(path.stem), is_name=True)]
        in_text = uses(path.read_text(encoding="utf-8"), avoided)
        places += [f"{path.relative_to(ROOT)}:{line}: {word}" for line, word in [*in_name, *in_text]]
    return places


def found_in_comments(avoided: AvoidedWords) -> list[str]:
    """Return ``file:line: word`` of each use in the comments of scripts, stylesheets, templates and SQL."""
    paths = (path for folder in COMMENTED for path in (ROOT / folder).rglob("*") if path.suffix in _COMMENTS)
    return [
        f"{path.relative_to(ROOT)}:{line}: {word}"
        for path in sorted(paths)
        for line, word in uses_in_comments(path.suffix, path.read_text(encoding="utf-8"), avoided)
    ]

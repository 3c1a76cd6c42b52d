"""The vocabulary of the code: the words that the glossary replaces, and the names of types."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
AVOIDED_WORDS = ROOT / "docs" / "words_to_avoid.txt"
_SECTION = "["
_TYPE_NAME = re.compile(r"_?[A-Z]\w*[a-z]\w*")
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


def modules() -> dict[str, ast.Module]:
    """Module name → syntax tree, for every module of app and bus."""
    paths = sorted(path for package in ("app", "bus") for path in (ROOT / package).rglob("*.py"))
    return {".".join(path.relative_to(ROOT).with_suffix("").parts): _parsed(path) for path in paths}


def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def defined_types(tree: ast.Module) -> Iterator[str]:
    """The name of each class, nested ones included, and of each type alias of a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            yield node.name
    for statement in tree.body:
        targets = statement.targets if isinstance(statement, ast.Assign) else []
        for target in targets:
            if isinstance(target, ast.Name) and _TYPE_NAME.fullmatch(target.id):
                yield target.id


def duplicate_types(trees: dict[str, ast.Module]) -> Counter[str]:
    """Type name → number of modules that define it, for each name that more than one defines."""
    counts = Counter(name for tree in trees.values() for name in set(defined_types(tree)))
    return Counter({name: count for name, count in counts.items() if count > 1})


def words_of(identifier: str) -> str:
    """Return the words of a text or a name in lower case, between spaces: ``" send late command "``."""
    return f" {' '.join(_WORD.findall(identifier)).lower()} "


def avoided_words(section: str = "") -> list[str]:
    """The words and phrases of a section of the list; the first has no name and is for all that is read."""
    parts = AVOIDED_WORDS.read_text(encoding="utf-8").split("\n" + _SECTION)
    named = dict([("", parts[0]), *(part.split("]", 1) for part in parts[1:])])
    return [line.partition(":")[0] for line in named[section].splitlines() if line and line[0] != "#"]


def in_text(words: list[str]) -> re.Pattern[str]:
    """Find the words in a text, each as a separate word; those that end in "is" only where they begin the
    text and so are used as a name.
    """
    names = [f"^{re.escape(word)}" for word in words if word.endswith(" is")]
    others = [re.escape(word) for word in words if not word.endswith(" is")]
    return re.compile(rf"(?<![\w-])(?:{'|'.join([*names, *others])})(?:s|es)?(?![\w-])", re.IGNORECASE)

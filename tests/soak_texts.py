"""The texts that tests expect which only ``make soak`` runs, compared with those that there are."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

from app.core.messages.languages import catalogs
from app.core.web.access import Role
from bus.catalogue.parameters import PARAMETERS
from bus.simulator.plant import demo_line
from tests.catalogs import catalog_at, wanted

ROOT = Path(__file__).resolve().parent.parent
SOAK = "pytest.mark.soak"
BY_FIRST = {"get_by_text", "get_by_label", "to_have_text", "to_contain_text"}
BY_NAME = {"get_by_role"}
_FIELD = re.compile(r"\{[^}]*\}")


def words_of(text: str) -> list[str]:
    """The words without the fields and the values in their places."""
    return re.findall(r"[^\W\d]+", _FIELD.sub("", text))


@cache
def texts() -> tuple[str, ...]:
    """The words of every text of pages and messages, in each language."""
    translated = (message.string for path in catalogs().values() for message in catalog_at(path))
    found = ((text,) if isinstance(text, str) else text for text in (*wanted().values(), *translated))
    return tuple(" ".join(words_of(text)) for forms in found for text in forms)


def is_known(expected: str) -> bool:
    """Whether a third of its pairs of words are in one text: names and other texts fill its fields."""
    words = words_of(expected)
    pairs = [" ".join(pair) for pair in pairwise(words)] or words
    return not words or any(3 * sum(pair in text for pair in pairs) >= len(pairs) for text in texts())


def soak_functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """The test functions of a module that are marked, each or all of them."""
    marked = f"pytestmark = {SOAK}" in map(ast.unparse, tree.body)
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (
            marked or SOAK in map(ast.unparse, node.decorator_list)
        ):
            yield node


def expected_texts(function: ast.AST) -> Iterator[tuple[int, str]]:
    """Each text that a function looks for on a page, with its line."""
    for call in ast.walk(function):
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Attribute):
            continue
        by_name = (word.value for word in call.keywords if word.arg == "name")
        given = call.args[:1] if call.func.attr in BY_FIRST else by_name if call.func.attr in BY_NAME else ()
        for each in given:
            if isinstance(each, ast.Constant) and isinstance(each.value, str):
                yield call.lineno, each.value


def names_in(tree: ast.Module) -> set[str]:
    """What a page shows in the fields of a text: names that the tests of a module give, those of the demo, of
    roles and parameters, and complete texts."""
    constants = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))
    elsewhere = Counter(each for each in constants if isinstance(each, str))
    elsewhere.subtract(text for _, text in expected_texts(tree))
    given = {" ".join(words_of(text)) for text, count in elsewhere.items() if count > 0}
    shown = {unit.name for unit in demo_line().settings} | {row.name for row in PARAMETERS.values()} | {*Role}
    return given | shown | {*texts()}


def without(names: set[str], text: str) -> str:
    """The words of a text without the names that are in it, the longest first."""
    words = words_of(text)
    for size in range(len(words), 0, -1):
        for start in range(len(words) - size + 1):
            if " ".join(words[start : start + size]) in names:
                before, after = words[:start], words[start + size :]
                return without(names, " ".join([*before, *after]))
    return " ".join(words)


def unknown_texts(file: Path) -> list[str]:
    """What the soak tests of a file look for that no page can show."""
    tree = ast.parse(file.read_text("utf-8"))
    found = [pair for function in soak_functions(tree) for pair in expected_texts(function)]
    unknown = [(line, text) for line, text in found if not is_known(text)]
    names = names_in(tree) if unknown else set()
    return [f"{file.name}:{line}: {text}" for line, text in unknown if not is_known(without(names, text))]

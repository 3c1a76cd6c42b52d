"""One word for one idea: a type name exists once, and words that the glossary replaces become fewer."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import pytest

from tests import vocabulary
from tests.vocabulary import source

TO_LOWER = "python -m tests.vocabulary lowers the bounds"


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    return vocabulary.modules()


def assert_equal_to_bounds(found: Counter[str], path: Path) -> None:
    """A greater count is a new defect. A lesser one is a bound that would let the defect come back."""
    bounds = vocabulary.bounds(path)
    assert found - bounds == Counter(), f"more than {path.name} allows"
    assert bounds - found == Counter(), f"less than {path.name} states; {TO_LOWER}"


def test_a_type_name_exists_once(trees: dict[str, ast.Module]) -> None:
    assert_equal_to_bounds(vocabulary.duplicate_types(trees), vocabulary.DUPLICATE_TYPES)


def test_identifiers_use_the_words_of_the_glossary(trees: dict[str, ast.Module]) -> None:
    found = vocabulary.avoided_identifiers(trees, vocabulary.avoided_words())
    assert_equal_to_bounds(found, vocabulary.AVOIDED_IDENTIFIERS)


def test_comments_docstrings_and_names_use_the_words_of_the_glossary() -> None:
    places = source.found(source.AvoidedWords(vocabulary.avoided_words()))
    more = source.by_folder(places) - vocabulary.bounds(source.AVOIDED_IN_SOURCE)
    assert [place for place in places if source.folder_of(place) in more] == []


@pytest.mark.parametrize(
    ("code", "uses"),
    [
        ("# the wish\n# of a person\nx = 1", [(1, "wish")]),
        ("# it is kept for\n# ever", [(1, "for ever")]),
        ('"""Wishes."""', [(1, "wishes")]),
        ('x = 1\n"""\nA\nwish."""', [(2, "wish")]),
        ('def f() -> None:\n    """What is wired."""', [(2, "what is")]),
        ('x = 1\n"""See what is wired."""', []),
        ('print("a wish")', []),
        ('x = ("a wish"\n     "two wishes")', []),
        ("def wish(): ...", [(1, "wish")]),
        ("what_is_wired = last_wish", [(1, "what is"), (1, "wish")]),
        ("self.LAST_WISH = WishList()", [(1, "wish"), (1, "wish")]),
        ("task = essay", []),
    ],
)
def test_a_word_is_found_in_comments_docstrings_and_names_only(
    code: str, uses: list[tuple[int, str]]
) -> None:
    assert list(source.uses(code, source.AvoidedWords(["wish", "ask", "say", "for ever", "what is"]))) == uses


def test_classes_and_aliases_are_types_and_constants_are_not() -> None:
    tree = ast.parse(
        "Kind = str\nLIMIT = 3\nT = TypeVar('T')\nclass Outer:\n    class Inner: ...\n    Not = 1\n"
    )
    assert sorted(vocabulary.defined_types(tree)) == ["Inner", "Kind", "Outer"]


def test_a_name_in_two_modules_is_a_duplicate_and_one_twice_in_a_module_is_not() -> None:
    twice = ast.parse("class Row: ...\nclass Kind: ...\nclass Kind: ...")
    trees = {"one": twice, "two": ast.parse("Row = int")}
    assert vocabulary.duplicate_types(trees) == Counter(Row=2)


@pytest.mark.parametrize(
    ("identifier", "word", "is_in"),
    [
        ("send_wish", "wish", True),
        ("WishList", "wish", True),
        ("wishes", "wish", True),
        ("HTTPWish", "wish", True),
        ("task", "ask", False),
        ("said_for_ever", "for ever", True),
        ("forever", "for ever", False),
        ("wholesale", "whole", False),
    ],
)
def test_a_word_is_found_between_word_boundaries(identifier: str, word: str, is_in: bool) -> None:
    assert vocabulary.contains(identifier, word) is is_in


def test_modules_functions_classes_and_parameters_are_identifiers() -> None:
    tree = ast.parse("class A:\n    async def b(self, *c, d, **e): local = 1\n")
    found = vocabulary.identifiers("app.live.browsers.hub", tree)
    assert sorted(found) == ["A", "b", "c", "d", "e", "hub", "self"]
    assert next(vocabulary.identifiers("app.live.__init__", tree)) == "live"


def test_bounds_are_lowered_and_never_raised(tmp_path: Path) -> None:
    path = tmp_path / "bounds.txt"
    path.write_text("# why\nfate 3\ntold 2\nwish 1\n")
    vocabulary.lower(path, Counter({"fate": 1, "wish": 5, "errand": 1}))
    assert path.read_text() == "# why\nfate 1\nwish 1\n"


def test_the_list_of_words_is_read_up_to_its_second_part() -> None:
    words = vocabulary.avoided_words()
    assert {"wish", "for ever"} <= set(words)
    assert "end" not in words
    assert len(words) == len(set(words))

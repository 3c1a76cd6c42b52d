"""One word for one idea: a type name exists once, and words that the glossary replaces are not used."""

from __future__ import annotations

import ast
from collections import Counter

import pytest

from tests import vocabulary
from tests.vocabulary import source


def test_a_type_name_exists_once() -> None:
    assert vocabulary.duplicate_types(vocabulary.modules()) == Counter()


def test_comments_docstrings_names_and_messages_use_the_words_of_the_glossary() -> None:
    words = vocabulary.avoided_words() + vocabulary.avoided_words("source")
    assert source.found(source.AvoidedWords(words)) == []


def test_comments_of_scripts_stylesheets_templates_and_sql_use_the_words_of_the_glossary() -> None:
    assert source.found_in_comments(source.AvoidedWords(vocabulary.avoided_words())) == []


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
        ('x = 1\nassert x, "a wish"', [(2, "wish")]),
        ('assert x == "wish", f"{x}: wishes"', [(1, "wishes")]),
    ],
)
def test_a_word_is_found_in_comments_docstrings_names_and_messages_only(
    code: str, uses: list[tuple[int, str]]
) -> None:
    assert list(source.uses(code, source.AvoidedWords(["wish", "ask", "say", "for ever", "what is"]))) == uses


@pytest.mark.parametrize(
    ("suffix", "code", "uses"),
    [
        (".js", "const wish = 1; // a wish\n", [(1, "wish")]),
        (".js", "// kept for\n// ever\nlet x;", [(1, "for ever")]),
        (".js", '\ntest("a wish", () => "wish");', [(2, "wish")]),
        (".js", 'fetch("a://wish");', []),
        (".css", ".wish { color: red; }\n/* wishes */", [(2, "wishes")]),
        (".html", "<p>wish</p>{#- a\nwish -#}", [(1, "wish")]),
        (".sql", "-- kept for\n-- ever\nCREATE TABLE wish", [(1, "for ever")]),
    ],
)
def test_a_word_is_found_in_comments_of_other_files(
    suffix: str, code: str, uses: list[tuple[int, str]]
) -> None:
    assert list(source.uses_in_comments(suffix, code, source.AvoidedWords(["wish", "for ever"]))) == uses


def test_classes_and_aliases_are_types_and_constants_are_not() -> None:
    tree = ast.parse(
        "Kind = str\nLIMIT = 3\nT = TypeVar('T')\nclass Outer:\n    class Inner: ...\n    Not = 1\n"
    )
    assert sorted(vocabulary.defined_types(tree)) == ["Inner", "Kind", "Outer"]


def test_a_name_in_two_modules_is_a_duplicate_and_one_twice_in_a_module_is_not() -> None:
    twice = ast.parse("class Row: ...\nclass Kind: ...\nclass Kind: ...")
    trees = {"one": twice, "two": ast.parse("Row = int")}
    assert vocabulary.duplicate_types(trees) == Counter(Row=2)


def test_the_list_of_words_is_read_up_to_its_second_part() -> None:
    words = vocabulary.avoided_words()
    assert {"wish", "for ever"} <= set(words)
    assert "end" not in words
    assert len(words) == len(set(words))

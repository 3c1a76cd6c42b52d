"""Texts that people read use the words of the glossary."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

import pytest

from app.messages.languages import DEFAULT, catalogs
from tests.catalogs import catalog_at
from tests.vocabulary import avoided_words, in_text, read_texts

ENGLISH = in_text(avoided_words() + avoided_words("texts"))
SCREEN = in_text(avoided_words("screen"))
GERMAN = in_text(avoided_words("German"))
Texts = Callable[[], Iterable[tuple[str, str]]]


@pytest.mark.parametrize(
    "texts", [read_texts.screen, read_texts.command_line, read_texts.api, read_texts.logs]
)
def test_no_text_has_a_word_to_avoid(texts: Texts) -> None:
    found = list(texts())
    assert [(where, text) for where, text in found if ENGLISH.search(text)] == []
    assert len({text for _, text in found if len(text) > 10}) > 15, "texts are found at all"


def test_no_document_has_a_word_to_avoid() -> None:
    """The words for screens alone are not among them: a document of the audit log is about proofs."""
    words = in_text(avoided_words())
    assert [(where, line) for where, line in read_texts.documents() if words.search(line)] == []


def test_no_german_text_has_a_word_to_avoid() -> None:
    assert [text for text in read_texts.translations("de") if GERMAN.search(text[1])] == []


def test_a_german_text_requests_in_the_infinitive() -> None:
    """As buttons do; one form for every text."""
    texts = read_texts.translations("de")
    assert [text for text in texts if re.search(r"\b\w+en Sie\b", text[1])] == []


def test_no_text_of_the_screen_has_a_word_that_operators_did_not_understand() -> None:
    """A code that the English catalog renders, such as offline, is not read itself."""
    codes = {message.id for message in catalog_at(catalogs()[DEFAULT]) if message.string}
    shown = [(where, text) for where, text in read_texts.screen() if text not in codes]
    assert [each for each in shown if SCREEN.search(each[1])] == []


def test_bedienfeld_is_the_keypad_of_the_drive_and_nothing_else() -> None:
    texts = read_texts.translations("de")
    assert [text for text in texts if "Bedienfeld" in text[1] and "keypad" not in text[0].lower()] == []


@pytest.mark.parametrize(
    ("text", "is_found"),
    [
        ("nobody holds it", True),
        ("Nobody", True),
        ("What is wired", True),
        ("see what is wired", False),
        ("unwished", False),
        ("the answers", True),
        ("task", False),
    ],
)
def test_a_word_is_found_as_a_word(text: str, is_found: bool) -> None:
    assert (ENGLISH.search(text) is not None) is is_found

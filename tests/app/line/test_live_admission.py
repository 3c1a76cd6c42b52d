"""How many pages may be open, and what they cost together."""

from __future__ import annotations

from app.line.live.hub import Watched
from app.line.live.requests import (
    MAX_OF_ACCOUNT,
    MAX_OF_ADDRESS,
    Admission,
)


def test_an_account_has_so_many_pages_and_another_has_its_own() -> None:
    admission = Admission()
    assert all(admission.enter("ann", f"a{n}") for n in range(MAX_OF_ACCOUNT))
    assert not admission.enter("ann", "b")
    assert admission.enter("ben", "b")
    admission.leave("ann", "a0")
    assert admission.enter("ann", "b")


def test_an_address_has_so_many_pages() -> None:
    admission = Admission()
    assert all(admission.enter(f"p{n}", "a") for n in range(MAX_OF_ADDRESS))
    assert not admission.enter("ann", "a")
    assert admission.enter("ann", "b")


def test_nothing_is_kept_of_who_has_gone() -> None:
    admission = Admission()
    admission.enter("ann", "a")
    admission.leave("ann", "a")
    assert not admission._by_account
    assert not admission._by_address


def test_what_any_page_shows_is_watched() -> None:
    watched = Watched({"dry": [1, 2, 3]})
    shown = watched.known(("dry/1", "dry/2", "dry/99", "wet/1", "dry/²", "dry"))
    assert shown == {("dry", 1), ("dry", 2)}
    watched.turn(frozenset(), shown, "", "dry")
    watched.turn(frozenset(), frozenset({("dry", 2)}), "", "")
    assert (watched.units("dry"), watched.is_traced("dry")) == ([1, 2], True)
    watched.turn(shown, frozenset({("dry", 3)}), "dry", "")
    assert (watched.units("dry"), watched.is_traced("dry")) == ([2, 3], False)

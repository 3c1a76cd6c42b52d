"""How many pages may be open, and what they cost together."""

from __future__ import annotations

from app.live.browsers.admission import (
    MOST_OF_ACCOUNT,
    MOST_OF_ADDRESS,
    MOST_OPENED_AT_ONCE,
    OPENED_A_SECOND,
    Admission,
)
from app.live.browsers.watched import Watched


def test_an_account_has_so_many_pages_and_another_has_its_own() -> None:
    admission = Admission()
    assert all(admission.enter("ann", f"a{n}", 0.0) for n in range(MOST_OF_ACCOUNT))
    assert not admission.enter("ann", "b", 1e6)
    assert admission.enter("ben", "b", 1e6)
    admission.leave("ann", "a0")
    assert admission.enter("ann", "b", 1e6)


def test_an_address_has_so_many_pages() -> None:
    admission = Admission()
    assert all(admission.enter(f"p{n}", "a", 0.0) for n in range(MOST_OF_ADDRESS))
    assert not admission.enter("ann", "a", 1e6)
    assert admission.enter("ann", "b", 1e6)


def test_pages_are_opened_and_closed_no_quicker_than_a_plant_comes_back() -> None:
    admission, opened = Admission(), 0
    for _ in range(2 * MOST_OPENED_AT_ONCE):
        if admission.enter("ann", "a", 0.0):
            admission.leave("ann", "a")
            opened += 1
    assert opened == MOST_OPENED_AT_ONCE
    assert admission.enter("ann", "a", 2 / OPENED_A_SECOND)


def test_nothing_is_kept_of_who_has_gone() -> None:
    admission = Admission()
    admission.enter("ann", "a", 0.0)
    admission.leave("ann", "a")
    assert not admission._by_account
    assert not admission._by_address


def test_what_any_page_shows_is_watched() -> None:
    watched = Watched({"dry": [1, 2, 3]})
    shown = watched.known(frozenset({("dry", 1), ("dry", 2), ("dry", 99), ("wet", 1)}))
    assert shown == {("dry", 1), ("dry", 2)}
    watched.turn(frozenset(), shown, "", "dry")
    watched.turn(frozenset(), frozenset({("dry", 2)}), "", "")
    assert (watched.units("dry"), watched.is_traced("dry")) == ([1, 2], True)
    watched.turn(shown, frozenset({("dry", 3)}), "dry", "")
    assert (watched.units("dry"), watched.is_traced("dry")) == ([2, 3], False)

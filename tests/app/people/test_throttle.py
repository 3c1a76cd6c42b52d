"""How soon a sign-in may be tried again; the time is passed in."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.people.auth.throttle import (
    FIRST_WAIT_S,
    FORGOTTEN_AFTER_S,
    FREE,
    FREE_OF_PANEL,
    MAX_WAIT_S,
    OF_ADDRESS,
    OF_ADDRESS_WINDOW_S,
    OF_NAME,
    OF_NAME_EVERY_S,
    OF_PANEL_EVERY_S,
    Attempt,
    Throttle,
)

ANN = Attempt("ann", "192.0.2.1")
OWN = Attempt("ann", "her browser", own_browser=True)
COLLEAGUE = Attempt("ann", "192.0.2.1", used_network=True)


def fail(throttle: Throttle, attempt: Attempt, now: float, times: int = 1) -> None:
    for _ in range(times):
        throttle.begin(attempt, now)
        throttle.failed(attempt, now)


def test_a_name_at_one_place_waits_twice_as_long_each_time() -> None:
    throttle, now, waits = Throttle(), 0.0, []
    for _ in range(FREE):
        assert throttle.wait_s(OWN, now) == 0.0
        fail(throttle, OWN, now)
    for _ in range(10):
        waits.append(throttle.wait_s(OWN, now))
        now += waits[-1]
        assert throttle.wait_s(OWN, now) == 0.0
        fail(throttle, OWN, now)
    assert waits[:3] == [FIRST_WAIT_S, 2 * FIRST_WAIT_S, 4 * FIRST_WAIT_S]
    assert waits[-1] == MAX_WAIT_S


def test_a_panel_waits_sooner() -> None:
    throttle, panel = Throttle(), Attempt("p1", "192.0.2.1", panel=True, own_browser=True)
    fail(throttle, panel, 0.0, FREE_OF_PANEL)
    assert throttle.wait_s(panel, 0.0) == FIRST_WAIT_S


def test_it_is_forgotten_after_a_quarter_of_an_hour_and_with_the_right_secret() -> None:
    throttle = Throttle()
    fail(throttle, OWN, 0.0, 20)
    assert throttle.wait_s(OWN, MAX_WAIT_S - 1) > 0
    fail(throttle, OWN, FORGOTTEN_AFTER_S + 1)
    assert throttle.wait_s(OWN, FORGOTTEN_AFTER_S + 1) == 0.0
    fail(throttle, OWN, FORGOTTEN_AFTER_S + 1, 20)
    throttle.succeeded(OWN, FORGOTTEN_AFTER_S + 2)
    assert throttle.wait_s(OWN, FORGOTTEN_AFTER_S + 2) == 0.0


def test_who_signs_in_leaves_what_was_tried_from_the_network() -> None:
    """Others who share it would learn from their next try that there is such a user."""
    throttle = Throttle()
    fail(throttle, COLLEAGUE, 0.0, FREE)
    assert throttle.wait_s(OWN, 0.0) == 0.0
    throttle.succeeded(COLLEAGUE, 0.0)
    throttle.succeeded(OWN, 0.0)
    assert throttle.wait_s(COLLEAGUE, 0.0) == FIRST_WAIT_S


def test_wrong_tries_in_a_browser_of_the_name_count_there_alone() -> None:
    throttle = Throttle()
    fail(throttle, OWN, 0.0, OF_ADDRESS)
    assert throttle.wait_s(OWN, 0.0) == MAX_WAIT_S
    assert throttle.wait_s(ANN, 0.0) == throttle.wait_s(COLLEAGUE, 0.0) == 0.0
    assert throttle.wait_s(Attempt("bob", OWN.place), 0.0) == 0.0


def test_others_at_the_same_place_do_not_wait() -> None:
    throttle = Throttle()
    fail(throttle, ANN, 0.0, FREE + 1)
    assert throttle.wait_s(ANN, 0.0) > 0
    assert throttle.wait_s(Attempt("bob", ANN.place), 0.0) == 0.0


def test_a_place_that_tries_many_names_waits_except_for_its_own() -> None:
    throttle = Throttle()
    for number in range(OF_ADDRESS):
        fail(throttle, Attempt(f"name{number}", ANN.place), 0.0)
    fresh = Attempt("fresh", ANN.place)
    assert throttle.wait_s(COLLEAGUE, 0.0) == throttle.wait_s(fresh, 0.0)
    assert throttle.wait_s(fresh, 0.0) == OF_ADDRESS_WINDOW_S / OF_ADDRESS
    assert throttle.wait_s(fresh, OF_ADDRESS_WINDOW_S / OF_ADDRESS) == 0.0
    assert throttle.wait_s(OWN, 0.0) == 0.0
    assert throttle.wait_s(Attempt("fresh", "192.0.2.2"), 0.0) == 0.0


@pytest.mark.parametrize(("panel", "every_s"), [(False, OF_NAME_EVERY_S), (True, OF_PANEL_EVERY_S)])
def test_many_places_that_try_one_name_get_one_try_in_a_while(panel: bool, every_s: float) -> None:
    throttle, tried, now = Throttle(), 0, 0.0
    while now < 3600.0:
        attempt = Attempt("ann", f"place{now}", panel)
        if throttle.wait_s(attempt, now) == 0.0:
            fail(throttle, attempt, now)
            tried += 1
        now += 1.0
    assert tried <= OF_NAME + 3600.0 / every_s
    assert throttle.wait_s(Attempt("ann", "her browser", panel, own_browser=True), now) == 0.0
    assert throttle.wait_s(Attempt("ann", "the office", panel, used_network=True), now) == 0.0
    assert throttle.wait_s(Attempt("bob", "place0", panel), now) == 0.0


def test_many_at_once_are_not_each_the_last_that_is_allowed() -> None:
    throttle = Throttle()
    begun = 0
    for number in range(100):
        attempt = Attempt("ann", f"place{number}")
        if throttle.wait_s(attempt, 0.0) == 0.0:
            throttle.begin(attempt, 0.0)
            begun += 1
    assert begun == OF_NAME


def test_who_signs_in_from_a_new_place_uses_up_nothing() -> None:
    throttle = Throttle()
    for number in range(100):
        attempt = Attempt("ann", f"place{number}")
        assert throttle.wait_s(attempt, 0.0) == 0.0
        throttle.begin(attempt, 0.0)
        throttle.succeeded(attempt, 0.0)


@given(st.lists(st.tuples(st.text(max_size=3), st.text(max_size=3), st.booleans()), max_size=200))
def test_memory_is_bounded(attempts: list[tuple[str, str, bool]]) -> None:
    throttle = Throttle(most=10)
    for number, (name, place, known) in enumerate(attempts):
        fail(throttle, Attempt(name, place, own_browser=known), float(number))
    assert (
        max(len(kept) for kept in (throttle._pairs, throttle._places, throttle._names, throttle._panels))
        <= 10
    )


def test_the_oldest_are_forgotten_first() -> None:
    throttle = Throttle(most=10)
    fail(throttle, OWN, 0.0, FREE)
    for number in range(9):
        fail(throttle, Attempt(f"name{number}", "x", own_browser=True), 1.0)
    assert throttle.wait_s(OWN, 1.0) > 0
    fail(throttle, Attempt("one more", "x", own_browser=True), 1.0)
    assert throttle.wait_s(OWN, 1.0) == 0.0

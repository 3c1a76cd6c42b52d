"""How many sign-ins may fail; the time is passed in."""

from __future__ import annotations

from app.auth.failures import PER_ADDRESS, PER_NAME, PER_PANEL, SWEEP_ABOVE, WINDOW_S, Failures


def test_a_name_is_refused_after_its_share_and_free_again_later() -> None:
    failures = Failures()
    for number in range(PER_NAME):
        assert not failures.too_many("ann", "a", number, panel=False)
        failures.note("ann", f"a{number}", number)
    assert failures.too_many("ann", "elsewhere", PER_NAME, panel=False)
    assert not failures.too_many("bob", "elsewhere", PER_NAME, panel=False)
    assert not failures.too_many("ann", "elsewhere", WINDOW_S, panel=False)


def test_a_pin_may_be_tried_less_often() -> None:
    failures = Failures()
    for _ in range(PER_PANEL):
        failures.note("panel", "a", 0.0)
    assert failures.too_many("panel", "a", 1.0, panel=True)
    assert not failures.too_many("panel", "a", 1.0, panel=False)


def test_an_address_that_tries_many_names() -> None:
    failures = Failures()
    for number in range(PER_ADDRESS):
        failures.note(f"name{number}", "10.0.0.1", 0.0)
    assert failures.too_many("fresh", "10.0.0.1", 1.0, panel=False)
    assert not failures.too_many("fresh", "10.0.0.2", 1.0, panel=False)


def test_the_right_secret_clears_the_name_but_not_the_address() -> None:
    failures = Failures()
    for _ in range(PER_ADDRESS):
        failures.note("ann", "a", 0.0)
    failures.forget("ann")
    assert not failures.too_many("ann", "b", 1.0, panel=False)
    assert failures.too_many("ann", "a", 1.0, panel=False)


def test_what_is_over_takes_no_memory() -> None:
    failures = Failures()
    for number in range(SWEEP_ABOVE):
        failures.note(f"n{number}", "a", 0.0)
    failures.note("late", "b", WINDOW_S + 1)
    failures.note("later", "b", WINDOW_S + 2)
    assert len(failures._at) < 10

"""A process that does not respond is given up, neither too soon nor for what the one before it did."""

from __future__ import annotations

from app.cli.hosting import MAX_MISSED, MAX_MISSED_AT_START, Watchdog


def looks_until_expired(watchdog: Watchdog) -> int:
    looks = 1
    while not watchdog.expires(responds=False):
        looks += 1
    return looks


def test_one_that_responded_is_given_up_after_its_limit() -> None:
    watchdog = Watchdog()
    assert not watchdog.expires(responds=True)
    assert not watchdog.expires(responds=True)
    assert looks_until_expired(watchdog) == MAX_MISSED


def test_every_response_begins_the_count_again() -> None:
    watchdog = Watchdog()
    for responds in (False, True) * MAX_MISSED_AT_START:
        assert not watchdog.expires(responds=responds)
    assert looks_until_expired(watchdog) == MAX_MISSED


def test_one_that_starts_has_longer() -> None:
    assert looks_until_expired(Watchdog()) == 1 + MAX_MISSED_AT_START


def test_a_response_at_the_first_look_may_be_of_the_one_before() -> None:
    watchdog = Watchdog()
    assert not watchdog.expires(responds=True)
    assert looks_until_expired(watchdog) == MAX_MISSED_AT_START

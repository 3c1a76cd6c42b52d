"""How many events of one series are recorded, and that the last state always is."""

from __future__ import annotations

from app.line.live.change_recorder import (
    BURST,
    FIRST_PAUSE_S,
    FORGIVEN_EVERY_S,
    MAX_PAUSE_S,
    QUIET_S,
    EventBudget,
    Summary,
)

KEY = ("run", 1)


def spent(now: float = 0.0) -> EventBudget:
    """A series that has had its share."""
    budget = EventBudget()
    assert all(budget.admits(KEY, number, now) for number in range(BURST))
    return budget


def test_few_events_are_recorded_one_by_one() -> None:
    budget = EventBudget()
    admitted = [budget.admits(KEY, hour, 3600.0 * hour) for hour in range(100)]
    assert all(admitted)
    assert budget.due(1e9) == []


def test_the_last_of_a_flood_is_recorded_once_it_is_quiet() -> None:
    budget = spent()
    assert not any(budget.admits(KEY, number, 10.0) for number in (100, 101, 102))
    assert budget.due(10.0 + QUIET_S - 1) == []
    assert budget.due(10.0 + QUIET_S) == [Summary(102, 3, QUIET_S)]
    assert budget.due(1e6) == []


def test_a_flood_without_end_is_recorded_ever_more_seldom() -> None:
    """A port that opens and closes four times a second, for a day."""
    budget, recorded, at = spent(), 0, 0.0
    while at < 86_400.0:
        at += 0.25
        recorded += budget.admits(KEY, 0, at)
        recorded += len(budget.due(at))
    assert 86_400 / MAX_PAUSE_S < recorded < 40


def test_a_series_that_was_quiet_for_long_has_its_share_again() -> None:
    budget = spent()
    assert not budget.admits(KEY, 1, 1.0)
    budget.due(FIRST_PAUSE_S + QUIET_S)
    later = FIRST_PAUSE_S + QUIET_S + BURST * FORGIVEN_EVERY_S
    assert all(budget.admits(KEY, number, later) for number in range(BURST))


def test_one_series_does_not_crowd_out_another() -> None:
    budget = spent()
    assert not budget.admits(KEY, 1, 1.0)
    assert budget.admits(("run", 2), 1, 1.0)


def test_nothing_is_lost_when_the_server_ends() -> None:
    budget = spent()
    budget.admits(KEY, 7, 1.0)
    assert budget.due(1.0, everything=True) == [Summary(7, 1, 0.0)]


def test_a_series_that_is_over_takes_no_memory() -> None:
    budget = EventBudget()
    for number in range(100):
        budget.admits(number, 0, 0.0)
    budget.due(2 * FORGIVEN_EVERY_S)
    assert budget._series == {}

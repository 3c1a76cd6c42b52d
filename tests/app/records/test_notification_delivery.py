"""The outbox of one address: whose turn it is, what is collected, when it is tried again."""

from __future__ import annotations

from datetime import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.records.notification.rules.delivery import (
    GATHER_S,
    GIVE_UP_S,
    MAX_RETRY_S,
    DeliveryTurn,
    EndpointLoad,
    Retry,
    heartbeat_due,
    next_turn,
    retry_after_s,
    state_after_failure,
)
from bus.instants import UnixTime

NOW = UnixTime(10_000.0)


def at(seconds: float) -> UnixTime:
    return NOW - seconds


def turn(load: EndpointLoad, flood: int = 2) -> DeliveryTurn:
    return next_turn(load, flood, 60.0, NOW)


def test_nothing_waits_for_something_new() -> None:
    assert turn(EndpointLoad([], [], [])) == DeliveryTurn()


def test_a_new_item_is_a_message_at_once() -> None:
    assert turn(EndpointLoad([(1, at(0)), (2, at(0))], [], [at(60)])) == DeliveryTurn(items=(1,))


def test_what_stood_at_a_start_is_gathered_and_holds_up_nothing() -> None:
    standing = [(1, at(2)), (2, at(0))]
    assert turn(EndpointLoad([], [], [], standing=standing)) == DeliveryTurn(wait_s=GATHER_S - 2)
    assert turn(EndpointLoad([(3, at(0))], [], [], standing=standing)) == DeliveryTurn(items=(3,))
    standing = [(1, at(GATHER_S)), (2, at(0))]
    assert turn(EndpointLoad([], [], [], standing=standing)) == DeliveryTurn(items=(1, 2))
    assert turn(EndpointLoad([], [], [], standing=[(1, at(-60))])) == DeliveryTurn(items=(1,))


def test_a_flood_is_collected() -> None:
    sent = [at(60), at(30)]
    assert turn(EndpointLoad([(1, at(59)), (2, at(0))], [], sent)) == DeliveryTurn(wait_s=1.0)
    assert turn(EndpointLoad([(1, at(60)), (2, at(0))], [], sent)) == DeliveryTurn(items=(1, 2))
    assert turn(EndpointLoad([(1, at(0))], [], [at(601), at(602)])) == DeliveryTurn(items=(1,))


def test_a_program_gets_each_alone() -> None:
    load = EndpointLoad([(1, at(0)), (2, at(0))], [], [at(60)] * 100, collects=False)
    assert turn(load) == DeliveryTurn(items=(1,))


def test_new_items_go_before_those_that_were_refused() -> None:
    retries = [Retry(7, 3, at(0)), Retry(8, 1, at(0)), Retry(9, 1, at(-5))]
    assert turn(EndpointLoad([(1, at(60))], retries, [])) == DeliveryTurn(items=(1,))
    assert turn(EndpointLoad([(1, at(50))], retries, [])) == DeliveryTurn(retry=8)
    assert turn(EndpointLoad([], retries[2:], [])) == DeliveryTurn(wait_s=5.0)


def test_a_clock_that_was_set_back_delays_no_retry() -> None:
    assert turn(EndpointLoad([], [Retry(7, 1, at(-MAX_RETRY_S - 1))], [])) == DeliveryTurn(retry=7)
    assert turn(EndpointLoad([(1, at(-3600))], [], [at(60), at(30)])) == DeliveryTurn(items=(1,))


def test_the_wait_doubles_up_to_a_quarter_of_an_hour() -> None:
    assert [retry_after_s(n) for n in (1, 2, 3)] == [5.0, 10.0, 20.0]
    assert retry_after_s(10_000) == MAX_RETRY_S


def test_a_message_is_given_up_after_a_day() -> None:
    assert state_after_failure(at(GIVE_UP_S - 1), NOW) == "retrying"
    assert state_after_failure(at(GIVE_UP_S), NOW) == "failed"


retries = st.lists(
    st.builds(Retry, st.integers(1, 9), st.integers(1, 5), st.floats(-2e3, 2e3).map(at)), max_size=4
)


@given(st.integers(0, 3), retries, st.integers(0, 4), st.booleans())
def test_there_is_always_a_turn_or_an_end_of_the_wait(
    items: int, several: list[Retry], sent: int, collects: bool
) -> None:
    load = EndpointLoad([(n, at(0)) for n in range(items)], several, [at(1)] * sent, collects)
    found = turn(load)
    is_idle = not items and not several
    assert is_idle == (found == DeliveryTurn())
    if found.wait_s is not None:
        assert 0 < found.wait_s <= MAX_RETRY_S


@pytest.mark.parametrize(
    ("before", "now", "day"),
    [
        ("2026-11-22T06:59:50", "2026-11-22T07:00:10", "2026-11-22"),
        ("2026-11-22T07:00:10", "2026-11-22T07:00:30", ""),
        ("2026-11-22T06:00:00", "2026-11-22T06:59:59", ""),
        ("2026-11-21T23:59:50", "2026-11-22T07:00:00", "2026-11-22"),
        ("2026-11-22T07:00:10", "2026-11-22T06:30:00", ""),
    ],
)
def test_a_heartbeat_is_due_when_its_time_has_come(before: str, now: str, day: str) -> None:
    assert heartbeat_due(datetime.fromisoformat(before), datetime.fromisoformat(now), 420) == day

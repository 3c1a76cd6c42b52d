"""When bytes arrived, as far as it can be known: the table of what keeps them waiting."""

from __future__ import annotations

from math import inf

import pytest

from app.server.connection.arrivals import FULL_READ_BYTES, ORDINARY_TURN_S, ConnectionArrivals

NOW = 1000.0


def accepted_long_ago() -> ConnectionArrivals:
    """A connection that has been quiet for a minute."""
    arrivals = ConnectionArrivals(opened_at=NOW - 100, accepted_at=NOW - 100)
    arrivals.received(NOW - 60, 200, polled_after=NOW - 60.05, waited_s=0.0)
    return arrivals


@pytest.mark.parametrize(
    ("polled_after", "waited_s", "arrived_at"),
    [
        pytest.param(NOW - 0.05, 0.0, NOW, id="the loop turns: it has just come"),
        pytest.param(NOW - 0.05, 0.004, NOW - 0.004, id="the kernel knows better"),
        pytest.param(NOW - 4, 4.0, NOW - 4, id="a stall, and the kernel agrees"),
        pytest.param(NOW - 4, 0.1, NOW - 4, id="a stall: the last byte is young, the first may not be"),
        pytest.param(NOW - 4, 0.0, NOW - 4, id="a stall, and no value of the kernel"),
        pytest.param(-inf, 0.0, NOW - 60, id="the loop is not watched: since the last read at most"),
        pytest.param(NOW - ORDINARY_TURN_S, 0.0, NOW, id="a turn of the loop that is no stall"),
    ],
)
def test_after_a_quiet_minute(polled_after: float, waited_s: float, arrived_at: float) -> None:
    arrivals = accepted_long_ago()
    assert arrivals.received(NOW, 200, polled_after=polled_after, waited_s=waited_s) == arrived_at


@pytest.mark.parametrize("polled_after", [-inf, NOW - 4, NOW - 0.01])
def test_what_waited_in_the_backlog_is_as_old_as_its_connection_at_most(polled_after: float) -> None:
    """Right after a start and right after a stall: a program that connects and writes at once is served."""
    waited = ConnectionArrivals(opened_at=NOW - 3, accepted_at=NOW - 0.001)
    assert waited.received(NOW, 200, polled_after=polled_after, waited_s=0.0) == NOW - 3
    fresh = ConnectionArrivals(opened_at=NOW - 0.002, accepted_at=NOW - 0.001)
    assert fresh.received(NOW, 200, polled_after=polled_after, waited_s=0.001) == NOW - 0.002


def test_a_write_directly_after_a_read_is_recent_without_a_loop_watch() -> None:
    arrivals = ConnectionArrivals(opened_at=NOW - 0.01, accepted_at=NOW - 0.01)
    arrivals.received(NOW - 0.005, 200, polled_after=-inf, waited_s=0.0)
    assert arrivals.received(NOW, 200, polled_after=-inf, waited_s=0.0) == NOW - 0.005


def test_what_was_left_in_the_kernel_behind_a_slow_request_is_as_old_as_that() -> None:
    arrivals = accepted_long_ago()
    arrivals.received(NOW - 5, 400, polled_after=NOW - 5.05, waited_s=0.0)
    arrivals.paused()
    assert arrivals.received(NOW - 1, 200, polled_after=NOW - 1.05, waited_s=0.2) == NOW - 5
    arrivals.resumed(NOW - 1)
    assert arrivals.received(NOW, 200, polled_after=NOW - 0.05, waited_s=0.0) == NOW


def test_just_resumed_it_has_not_been_looked_at_yet() -> None:
    arrivals = accepted_long_ago()
    arrivals.received(NOW - 5, 400, polled_after=NOW - 5.05, waited_s=0.0)
    arrivals.paused()
    arrivals.resumed(NOW - 0.01)
    assert arrivals.received(NOW, 200, polled_after=NOW - 0.05, waited_s=0.0) == NOW - 5


def test_the_rest_of_what_one_read_could_not_hold_is_as_old_as_its_beginning() -> None:
    arrivals = accepted_long_ago()
    first = arrivals.received(NOW, FULL_READ_BYTES, polled_after=NOW - 4, waited_s=0.0)
    assert arrivals.received(NOW + 0.001, 200, polled_after=NOW - 4, waited_s=0.0) == first == NOW - 4

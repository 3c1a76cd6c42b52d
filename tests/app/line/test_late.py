"""Which late updates of a worker are taken in: of the time that its bus was not followed, each once."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from app.line.feed.plausibility import FIRST_S, OFFSET_ERROR_S, REPEATED_S, Coverage, LateReadings, LateWindow
from bus.contract import (
    MAX_UPDATES,
    Batch,
    BusFigures,
    BusLink,
    ParameterValue,
    Reading,
    UnitLink,
    Update,
)

NOW = 2_000_000.0
READING = Reading(1, NOW, 5, 5, 0, 0, 0)
OF_ALL_KINDS = [READING, ParameterValue(1, 3, NOW, 1), UnitLink(1, NOW, "offline"), BusLink(NOW, "closed")]


def window() -> LateWindow:
    """Of a worker that connects now, ten minutes after its bus was last followed."""
    return Coverage(NOW - 600).window(NOW)


@pytest.mark.parametrize("update", OF_ALL_KINDS, ids=lambda update: type(update).__name__)
@pytest.mark.parametrize(
    ("age_s", "is_taken"),
    [
        (7 * 86_400.0, False),
        (600.0, False),
        (599.9, True),
        (300.0, True),
        (0.0, True),
        (-OFFSET_ERROR_S - 0.1, False),
    ],
)
def test_only_the_time_without_a_worker_is_taken(update: Update, age_s: float, is_taken: bool) -> None:
    late = window()
    assert late.admits(replace(update, at=NOW - age_s), 0.0, late.until) is is_taken


@pytest.mark.parametrize(("age_s", "is_repeated"), [(599.9, False), (600.0, True), (600 + REPEATED_S, False)])
def test_what_was_not_confirmed_before_a_crash_is_sent_again(age_s: float, is_repeated: bool) -> None:
    assert window().is_repeated(replace(READING, at=NOW - age_s)) is is_repeated
    assert not window().is_repeated(BusFigures(NOW - age_s, 1.0, 1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("age_s", "is_known"), [(599.9, False), (600.0, True), (659.9, True), (660.0, False)]
)
def test_a_live_reading_of_the_time_before_the_connection(age_s: float, is_known: bool) -> None:
    """One of much earlier is by a clock that was set back."""
    assert window().is_known(replace(READING, at=NOW - age_s)) is is_known
    assert not window().is_known(UnitLink(1, NOW - age_s, "offline"))


def test_what_history_does_not_keep_is_not_judged() -> None:
    assert window().admits(BusFigures(0.0, 1.0, 1.0, 1.0, 1.0), 0.0, NOW)


def test_readings_of_a_unit_are_taken_in_their_order_and_once() -> None:
    late = window()
    given = [(1, -500.0), (1, -499.0), (1, -499.0), (1, -499.5), (2, -499.5), (1, -498.0)]
    taken = [late.admits(replace(READING, unit=unit, at=NOW + at), 0.0, NOW) for unit, at in given]
    assert taken == [True, True, False, False, True, True]


def test_the_order_is_that_of_the_workers_clock() -> None:
    """Its offset is estimated better with each message: a later reading then has an earlier time."""
    late = window()
    assert late.admits(replace(READING, at=NOW - 500 + 0.3), 0.3, NOW)
    assert late.admits(replace(READING, at=NOW - 500 + 0.1), 0.0, NOW)


def test_a_first_worker_is_believed_as_far_as_it_keeps_anything() -> None:
    first = Coverage().window(NOW)
    assert (first.since, first.until) == (NOW - FIRST_S, NOW + OFFSET_ERROR_S)


def batch(*at: float, live: bool = True, sent_at: float = NOW) -> Batch:
    return Batch(1, sent_at, [replace(READING, at=each) for each in at], live=live)


@pytest.mark.parametrize(
    ("received", "until"),
    [
        (batch(), NOW),
        (batch(NOW - 1), NOW),
        (batch(sent_at=NOW + 3600), NOW),
        (batch(NOW - 300, NOW - 299, live=False), NOW - 299),
        (batch(live=False), NOW - 600),
        (batch(NOW - 700, live=False), NOW - 600),
        (batch(*[NOW - 30] * MAX_UPDATES), NOW - 30),
    ],
    ids=["nothing new", "live", "ahead", "late", "late, nothing taken", "before", "full"],
)
def test_how_far_a_bus_is_followed_by_a_batch(received: Batch, until: float) -> None:
    coverage = Coverage(NOW - 600)
    coverage.advance(received, received.updates, NOW)
    assert coverage.until == until


def test_a_backlog_alone_shows_nothing_of_a_bus_that_is_not_known() -> None:
    coverage = Coverage()
    coverage.advance(batch(live=False), [], NOW)
    assert coverage.until is None


def test_a_connection_that_ends_in_its_backlog_goes_on_where_it_ended() -> None:
    coverage = Coverage(NOW - 600)
    part = batch(NOW - 600, NOW - 400, live=False)
    coverage.advance(part, part.updates, NOW)
    assert coverage.window(NOW + 60).since == NOW - 400


def test_a_clock_that_was_set_back_refuses_the_time_before_and_not_all_that_follows() -> None:
    coverage = Coverage(NOW)
    assert coverage.window(NOW - 3600).since == NOW - 3600
    assert coverage.window(NOW - 3000).since == NOW - 3600


def test_late_readings_are_counted_with_their_span() -> None:
    late = LateReadings()
    late.add([UnitLink(1, NOW - 90, "offline")])
    assert late == LateReadings()
    for ages in ((60, 50), (40, 30)):
        late.add([replace(READING, at=NOW - age) for age in ages])
    assert late == LateReadings(4, NOW - 60, NOW - 30)

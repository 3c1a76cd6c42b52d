"""Updates buffered while the app is away: in order, numbered without a gap, bounded."""

from __future__ import annotations

import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.contract import BusFigures, Frame, Frames, Progress, Reading, Result, UnitLink, Update
from bus.worker.outbox import MAX_OTHERS, MAX_READINGS, Outbox


def reading(number: int) -> Reading:
    return Reading(1, float(number), number, number, 0, 0, 0)


def result(number: int) -> Result:
    return Result(f"r{number}", float(number), "verified")


def drain(outbox: Outbox) -> list[Update]:
    updates: list[Update] = []
    while (batch := outbox.next_batch(0.0)) is not None:
        updates += batch.updates
    return updates


@pytest.fixture
def outbox() -> Outbox:
    box = Outbox(most_readings=10, most_others=5)
    box.resume(0)
    return box


def test_each_update_goes_at_once_and_what_piled_up_goes_together(outbox: Outbox) -> None:
    outbox.put([reading(1)])
    first = outbox.next_batch(5.0)
    assert first is not None
    assert (first.seq, first.sent_at, first.live, first.updates) == (1, 5.0, True, [reading(1)])
    outbox.put([reading(2)])
    outbox.put([reading(3)])
    second = outbox.next_batch(6.0)
    assert second is not None
    assert (second.seq, len(second.updates)) == (2, 2)
    assert outbox.next_batch(7.0) is None
    assert not outbox.filled.is_set()


def test_after_a_break_all_that_the_app_does_not_have_comes_again_in_order(outbox: Outbox) -> None:
    for number in range(4):
        outbox.put([reading(number)])
        outbox.next_batch(0.0)
    outbox.delivered(1)
    outbox.disconnected()
    outbox.put([reading(4)])
    outbox.resume(2)
    batch = outbox.next_batch(0.0)
    assert batch is not None
    assert (batch.seq, batch.live) == (3, False)
    assert batch.updates == [reading(2), reading(3), reading(4)]
    outbox.put([reading(5)])
    batch = outbox.next_batch(0.0)
    assert batch is not None
    assert (batch.seq, batch.live, batch.updates) == (4, True, [reading(5)])


def test_what_came_after_the_backlog_is_live_even_in_one_go(outbox: Outbox) -> None:
    outbox.disconnected()
    outbox.put([reading(1)])
    outbox.resume(0)
    outbox.put([reading(2)])
    lives = []
    while (batch := outbox.next_batch(0.0)) is not None:
        lives += [(batch.live, update) for update in batch.updates]
    assert lives == [(False, reading(1)), (True, reading(2))]


def test_the_oldest_readings_go_first_and_are_counted(outbox: Outbox) -> None:
    outbox.disconnected()
    outbox.put([reading(number) for number in range(15)])
    assert outbox.lost == 5
    outbox.resume(0)
    assert drain(outbox) == [reading(number) for number in range(5, 15)]


def test_results_outlive_readings_and_keep_their_place(outbox: Outbox) -> None:
    outbox.disconnected()
    outbox.put([reading(0), result(1)])
    outbox.put([reading(number) for number in range(2, 14)])
    outbox.put([result(14)])
    outbox.resume(0)
    assert drain(outbox) == [result(1), *[reading(number) for number in range(4, 14)], result(14)]


def test_what_was_sent_but_never_confirmed_is_bounded_too(outbox: Outbox) -> None:
    for number in range(30):
        outbox.put([reading(number), result(number)] if number == 3 else [reading(number)])
        outbox.next_batch(0.0)
    assert len(outbox) <= 15
    outbox.disconnected()
    outbox.resume(0)
    assert drain(outbox) == [result(3), *[reading(number) for number in range(20, 30)]]


def test_momentary_updates_are_not_kept(outbox: Outbox) -> None:
    passing: list[Update] = [Progress("a", 0.0, "sent"), BusFigures(0.0, 1, 1, 1, 1), Frames([])]
    outbox.put(passing)
    outbox.disconnected()
    outbox.put(passing)
    outbox.put([UnitLink(1, 0.0, "online")])
    outbox.resume(0)
    assert drain(outbox) == [UnitLink(1, 0.0, "online")]


def test_what_the_app_would_refuse_for_its_age_is_dropped_and_counted(outbox: Outbox) -> None:
    old, fresh = UnitLink(1, 10.0, "online"), UnitLink(1, 20.0, "offline")
    outbox.put([old, fresh])
    outbox.resume(0, oldest=20.0)
    assert drain(outbox) == [fresh]
    assert outbox.lost == 1


def test_an_app_that_never_confirms_costs_nothing_for_momentary_updates(outbox: Outbox) -> None:
    outbox.resume(0)
    for _ in range(1000):
        outbox.put([BusFigures(0.0, 1, 1, 1, 1), Frames([])])
        assert outbox.next_batch(0.0) is not None
    assert len(outbox) == 0
    assert len(outbox._sent) == 0


def test_a_result_with_many_frames_counts_as_many() -> None:
    outbox = Outbox(most_others=100)
    frame = Frame(0.0, "in", b"", [])
    outbox.put([Result(str(number), 0.0, "verified", frames=[frame] * 200) for number in range(50)])
    outbox.resume(0)
    assert len(drain(outbox)) == 4


def test_an_app_that_is_away_for_hours_costs_no_more_than_a_few_megabytes() -> None:
    part = 20
    outbox, sizes = Outbox(MAX_READINGS // part, MAX_OTHERS // part), []
    tracemalloc.start()
    try:
        for _ in range(3):
            for number in range(MAX_READINGS // part):
                outbox.put([reading(number), result(number)])
            sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert part * sizes[-1] < 20_000_000
    assert sizes[-1] < 1.05 * sizes[0], "it grew although it was full"


@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("put"), st.integers(1, 4)),
            st.tuples(st.just("send"), st.just(0)),
            st.tuples(st.just("confirm"), st.integers(0, 5)),
            st.tuples(st.just("break"), st.integers(0, 5)),
        ),
        max_size=60,
    )
)
def test_whatever_happens_nothing_is_lost_doubled_or_out_of_order(steps: list[tuple[str, int]]) -> None:
    """A model of the app: it stores a batch once by its number and confirms the last one."""
    outbox, made, sent = Outbox(10_000), 0, []
    outbox.resume(0)
    app: list[Update] = []
    seq = 0
    for step, amount in steps:
        if step == "put":
            outbox.put([reading(made + place) for place in range(amount)])
            made += amount
        elif step == "send" and (batch := outbox.next_batch(0.0)) is not None:
            sent.append(batch)
        elif step == "confirm":
            for batch in sent[: amount + 1]:
                assert batch.seq == seq + 1
                seq, app = batch.seq, app + batch.updates
            sent = sent[amount + 1 :]
            outbox.delivered(seq)
        elif step == "break":
            sent = []
            outbox.disconnected()
            outbox.resume(seq)
    sent = []
    outbox.resume(seq)
    app += drain(outbox)
    assert app == [reading(number) for number in range(made)]


# --- the app's clock -----------------------------------------------------------------------------

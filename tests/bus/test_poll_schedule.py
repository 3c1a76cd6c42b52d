"""The schedule, played with made-up times: who gets the wire, how much of it, and at which rate."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.catalogue.parameters import NEEDED_TO_SHOW, PARAMETERS
from bus.line.poll_schedule import (
    JITTER,
    LOOK_ELSEWHERE_S,
    MIN_SHARE_OF_A_TURN,
    STEPS_S,
    WATCHED_HZ,
    BaudSearch,
    ParameterQueue,
    PollOrder,
    PollSchedule,
    ProbeBackoff,
    Task,
    TaskKind,
    WireShare,
)

POLL_S = 0.026
PARAMETER_S = 0.020
TIMEOUT_S = 0.068


@dataclass
class Line:
    """Plays a schedule against units that respond, except for those in ``dead``."""

    schedule: PollSchedule
    dead: set[int] = field(default_factory=set)
    now: float = 0.0
    tasks: list[tuple[float, Task, float]] = field(default_factory=list)
    """When, what, and for how long."""

    def play(self, until: float, *, slow: bool = False) -> Line:
        while self.now < until:
            task = self.schedule.next(self.now, slow_waits=slow)
            if task is None:
                self.now = min(at for at in self.schedule.moments(slow_waits=slow) if at > self.now)
                continue
            self._carry_out(task)
        return self

    def _carry_out(self, task: Task) -> None:
        responded = task.unit not in self.dead
        seconds = POLL_S if task.kind is not TaskKind.PARAMETER else PARAMETER_S
        seconds = seconds if responded else TIMEOUT_S
        began, self.now = self.now, self.now + seconds
        self.schedule.spent(task, began, self.now, responded=responded)
        self.tasks.append((began, task, seconds))
        if task.kind is TaskKind.SLOW:
            return
        if not responded:
            self.schedule.stopped_responding(task.unit, self.now)
        else:
            self.schedule.responded(task.unit, self.now)
            if task.kind is TaskKind.PARAMETER:
                self.schedule.parameters.was_read(task.unit, task.number, available=True)

    def of(self, *kinds: TaskKind, since: float = 0.0) -> Iterator[tuple[float, Task, float]]:
        return (entry for entry in self.tasks if entry[0] >= since and entry[1].kind in kinds)

    def share(self, *kinds: TaskKind, since: float = 0.0) -> float:
        return sum(seconds for _, _, seconds in self.of(*kinds, since=since)) / (self.now - since)


def line_of(units: int, dead: Collection[int] = (), least_scan_s: float = 0.0) -> Line:
    schedule = PollSchedule(range(1, units + 1), POLL_S, seed=7, least_scan_s=least_scan_s)
    return Line(schedule, set(dead))


def test_the_first_response_of_every_unit_comes_before_all_else() -> None:
    line = line_of(8).play(1.0)
    assert [(task.kind, task.unit) for _, task, _ in line.tasks[:8]] == [
        (TaskKind.FIRST, u) for u in range(1, 9)
    ]


def test_the_decimals_of_all_units_are_read_before_anything_else() -> None:
    line = line_of(4).play(1.0)
    assert [(task.unit, task.number) for _, task, _ in line.of(TaskKind.PARAMETER)][:4] == [
        (1, 3),
        (2, 3),
        (3, 3),
        (4, 3),
    ]


def test_without_open_pages_it_is_an_exact_rotation() -> None:
    line = line_of(5).play(30.0)
    units = [task.unit for _, task, _ in line.of(TaskKind.POLL, since=5.0)]
    first = units.index(1)
    assert units[first : first + 10] == [1, 2, 3, 4, 5, 1, 2, 3, 4, 5]


def test_all_parameters_are_read_in_time_and_again_later() -> None:
    line = line_of(2).play(300.0)
    counts = Counter((task.unit, task.number) for _, task, _ in line.of(TaskKind.PARAMETER))
    assert set(counts) == {(unit, number) for unit in (1, 2) for number in PARAMETERS}
    assert min(counts.values()) >= 1
    assert max(counts.values()) >= 2


def test_the_slow_scan_leaves_the_fast_scan_its_wire() -> None:
    line = line_of(8).play(60.0)
    assert line.share(TaskKind.PARAMETER, since=10.0) < 0.015
    assert line.share(TaskKind.POLL, since=10.0) > 0.97


@given(units=st.integers(2, 40), watched=st.integers(1, 40))
def test_a_watched_unit_never_takes_more_than_its_share(units: int, watched: int) -> None:
    chosen = set(range(1, min(watched, units) + 1))
    turns = PollOrder(range(1, units + 1), POLL_S)
    for unit in range(1, units + 1):
        turns.join(unit)
    turns.watch(chosen)
    counts = Counter(turns.next_unit() for _ in range(units * 60))
    equal = 60
    for unit in range(1, units + 1):
        count = counts[unit]
        if unit in chosen:
            assert count >= equal - 2
            assert count <= max(equal, WATCHED_HZ * POLL_S * equal * units) + 2
        else:
            assert count >= MIN_SHARE_OF_A_TURN * equal - 2


@pytest.mark.parametrize("opened", [3, 250])
def test_a_unit_with_an_open_page_is_polled_at_once_and_steadily(opened: int) -> None:
    turns = PollOrder(range(1, 256), POLL_S)
    for unit in range(1, 256):
        turns.join(unit)
    for _ in range(255 + 200):
        turns.next_unit()
    turns.watch({opened})
    taken = [turns.next_unit() for _ in range(1000)]
    places = [-1, *(place for place, unit in enumerate(taken) if unit == opened)]
    steps = [later - earlier for earlier, later in pairwise(places)]
    assert max(steps) <= 5
    assert min(steps[1:]) >= 3, "the turns of the others lie between its own"
    assert set(taken) == set(range(1, 256))


def test_one_watched_unit_of_eight_is_polled_at_most_ten_times_a_second() -> None:
    line = line_of(8)
    line.schedule.watch({3})
    line.play(40.0)
    counts = Counter(task.unit for _, task, _ in line.of(TaskKind.POLL, since=20.0))
    assert 8.5 < counts[3] / 20.0 <= WATCHED_HZ
    others = [counts[unit] / 20.0 for unit in range(1, 9) if unit != 3]
    assert max(others) - min(others) <= 0.1
    assert min(others) > 38.4 / 8 * MIN_SHARE_OF_A_TURN


def test_a_unit_that_leaves_has_no_more_turns() -> None:
    turns = PollOrder([1, 2], POLL_S)
    turns.join(1)
    turns.join(2)
    turns.leave(1)
    assert {turns.next_unit() for _ in range(10)} == {2}
    turns.leave(2)
    assert turns.next_unit() is None


def test_a_dead_unit_costs_one_timeout_for_each_step() -> None:
    line = line_of(8, dead={4}).play(120.0)
    probes = [at for at, task, _ in line.of(TaskKind.PROBE)]
    waits = [later - at for at, later in pairwise(probes)]
    assert {task.unit for _, task, _ in line.of(TaskKind.PROBE)} == {4}
    assert max(waits) <= STEPS_S[-1] + 0.2
    assert min(waits[5:]) > STEPS_S[-1] * 0.75
    assert line.share(TaskKind.PROBE, since=30.0) < 0.01


@pytest.mark.parametrize("units", [8, 32, 100])
def test_many_dead_units_together_cost_a_twentieth(units: int) -> None:
    line = line_of(units, dead=set(range(2, units + 1))).play(300.0)
    assert line.share(TaskKind.PROBE, since=30.0) <= 0.051
    probed = Counter(task.unit for _, task, _ in line.of(TaskKind.PROBE))
    assert set(probed) == set(range(2, units + 1)), "and none is forgotten"


def test_the_others_keep_their_rate_while_one_is_dead() -> None:
    well, ill = line_of(8).play(60.0), line_of(8, dead={5}).play(60.0)

    def rate(line: Line) -> int:
        return sum(task.unit == 1 for _, task, _ in line.of(TaskKind.POLL, since=10.0))

    assert rate(ill) >= 0.98 * rate(well)


def test_a_returned_unit_is_relearned() -> None:
    line = line_of(2).play(60.0)
    line.dead.add(2)
    line.schedule.stopped_responding(2, line.now)
    line.play(80.0)
    line.dead.clear()
    line.play(100.0)
    again = {task.number for _, task, _ in line.of(TaskKind.PARAMETER, since=80.0) if task.unit == 2}
    assert again >= set(NEEDED_TO_SHOW)


def test_after_a_write_the_needed_ones_are_read_again() -> None:
    line = line_of(2).play(60.0)
    line.schedule.parameters.need(1)
    line.play(61.5)
    again = {task.number for _, task, _ in line.of(TaskKind.PARAMETER, since=60.0) if task.unit == 1}
    assert again >= set(NEEDED_TO_SHOW)


def test_a_parameter_that_a_unit_does_not_have_is_not_read_again() -> None:
    schedule = line_of(1).play(0.01).schedule
    schedule.parameters.forget(1)
    schedule.parameters.was_read(1, 40, available=False)
    assert schedule.parameters.next_background() is None
    schedule.parameters.was_read(1, 39, available=True)
    assert schedule.parameters.next_background() == (1, 39)


@pytest.mark.parametrize(("any_page", "low", "high"), [(True, 0.08, 0.11), (False, 0.9, 0.96)])
def test_a_slow_read_takes_the_gaps(any_page: bool, low: float, high: float) -> None:
    line = line_of(8)
    line.schedule.watch(range(1, 9) if any_page else ())
    line.play(10.0).play(40.0, slow=True)
    assert low < line.share(TaskKind.SLOW, since=10.0) < high


def test_scan_time_and_what_one_more_costs() -> None:
    line = line_of(8).play(60.0)
    assert line.schedule.scan_s() == pytest.approx(8 * POLL_S, rel=0.05)
    assert line.schedule.scan_s(1) / line.schedule.scan_s() == pytest.approx(9 / 8)
    assert PollSchedule([], POLL_S).scan_s(1) == pytest.approx(POLL_S)


def test_a_limit_spreads_the_polls_evenly_and_leaves_the_rest_of_the_wire_free() -> None:
    line = line_of(8, least_scan_s=1.0).play(60.0)
    polls = list(line.of(TaskKind.POLL, since=30.0))
    assert [task.unit for _, task, _ in polls[:16]] == [task.unit for _, task, _ in polls[8:24]]
    times = [at for at, _, _ in polls]
    assert times[-1] - times[0] == pytest.approx((len(times) - 1) / 8, abs=0.1)
    assert max(after - before for before, after in pairwise(times)) < 2 / 8
    assert line.share(*TaskKind, since=30.0) < 8 * POLL_S + 0.02
    assert line.schedule.scan_s() == line.schedule.scan_s(1) == 1.0


def test_a_limit_holds_neither_the_first_responses_nor_parameters_nor_probes_up() -> None:
    line = line_of(8, dead={3}, least_scan_s=10.0).play(60.0)
    read = {(task.unit, task.number) for _, task, _ in line.of(TaskKind.PARAMETER)}
    assert read >= {(unit, number) for unit in (1, 2, 4, 5, 6, 7, 8) for number in NEEDED_TO_SHOW}
    assert [task.kind for _, task, _ in line.tasks[:8]] == [TaskKind.FIRST] * 8
    assert len(list(line.of(TaskKind.PROBE))) >= 4
    assert 7 * 5 <= len(list(line.of(TaskKind.POLL))) <= 7 * 6 + 1


@given(st.lists(st.floats(0.001, 1.0), min_size=20, max_size=60), st.floats(0.05, 0.9))
def test_a_share_is_kept_however_long_its_uses_are(uses: list[float], fraction: float) -> None:
    share, now, used = WireShare(fraction), 0.0, 0.0
    for seconds in uses:
        now = max(now, share.ready_at)
        assert share.ready(now)
        share.spend(now, seconds)
        now += seconds
        used += seconds
    assert used <= fraction * max(now, share.ready_at) + 1e-6


@given(st.integers(0, 1000))
def test_a_back_off_never_exceeds_ten_seconds(seed: int) -> None:
    backoff = ProbeBackoff(seed)
    backoff.alone = False
    backoff.stopped_responding(1, 0.0)
    now = 0.0
    for _ in range(10):
        due = backoff.wake_at()
        assert due is not None
        assert due - now <= STEPS_S[-1]
        now = due
        assert backoff.due(now) == 1
        backoff.no_response(1, now, 0.01)
    due = backoff.wake_at()
    assert due is not None
    assert due - now > STEPS_S[-1] * (1 - JITTER) - 1e-6


def test_every_fourth_read_of_the_slow_scan_is_the_decimals_of_the_next_unit() -> None:
    gaps = ParameterQueue(range(1, 41), NEEDED_TO_SHOW)
    for unit in (1, 2):
        for number in range(1, 41):
            gaps.was_read(unit, number, available=True)
    taken = []
    for _ in range(8):
        wanted = gaps.next_background()
        assert wanted is not None
        gaps.was_read(*wanted, available=True)
        taken.append(wanted)
    assert taken == [(1, 1), (1, 2), (1, 4), (1, 3), (1, 5), (1, 6), (1, 7), (2, 3)]


def test_what_a_setpoint_needs_is_read_of_all_units_first() -> None:
    queue = ParameterQueue(range(1, 41), NEEDED_TO_SHOW)
    for unit in (1, 2):
        queue.learn_all(unit)
    first = [queue.next_needed() for _ in range(8)]
    assert first == [(1, 3), (2, 3), (1, 8), (2, 8), (1, 2), (2, 2), (1, 1), (2, 1)]


LONG = LOOK_ELSEWHERE_S + 0.1


def expecting_4800() -> BaudSearch:
    rate = BaudSearch(0.0)
    rate.expect(4800, 9600)
    return rate


def at_4800() -> BaudSearch:
    """Return a search at the expected rate, after no response at 9600."""
    rate = expecting_4800()
    assert rate.turn(LONG, 9600, responds=False) == 4800
    rate.tuned(LONG)
    return rate


def test_without_an_expected_rate_a_line_without_responses_stays_at_its_rate() -> None:
    assert BaudSearch(0.0).turn(100.0, 9600, responds=False) is None


def test_a_line_without_responses_is_polled_at_both_rates_in_turn() -> None:
    assert expecting_4800().turn(LOOK_ELSEWHERE_S, 9600, responds=False) is None
    rate = at_4800()
    assert rate.turn(LONG + 0.1, 4800, responds=False) is None
    assert rate.turn(2 * LONG, 4800, responds=False) == 9600
    rate.tuned(2 * LONG)
    assert rate.turn(100.0, 9600, responds=True) is None, (
        "it was switched off, and is not at its new rate yet"
    )
    assert rate.turn(200.0, 9600, responds=False) == 4800


def test_a_response_at_the_expected_rate_ends_the_search() -> None:
    rate = expecting_4800()
    assert rate.turn(100.0, 9600, responds=True) is None, "some have not been switched off and on yet"
    assert rate.turn(100.0, 4800, responds=True) is None
    assert rate.turn(200.0, 4800, responds=False) is None


@pytest.mark.parametrize("present", [9600, 2400])
def test_a_change_that_left_every_unit_at_its_rate_ends_the_expectation(present: int) -> None:
    rate = expecting_4800()
    rate.expect(present, present)
    assert rate.turn(100.0, present, responds=False) is None

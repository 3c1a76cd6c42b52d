"""Values: missing responses make a gap, an unchanged value or a slow line does not; bits are exact intervals
in whatever order the minutes come; values have the scale of their time."""

from __future__ import annotations

from itertools import pairwise, permutations

from hypothesis import given
from hypothesis import strategies as st

from app.line.history.series.runs import MINUTE, SECOND, Run
from app.line.history.series.values import (
    VALUES,
    Interval,
    Marks,
    ParameterStep,
    holes,
    intervals,
    scaling,
    splice,
    usual_interval,
)
from tests.app.history_line import BUS

POLLS = [i * SECOND // 5 for i in range(100)]
USUAL = SECOND // 5


def without(start: int, end: int) -> list[int]:
    return [at for at in POLLS if not start < at < end]


def test_regular_polls_have_no_gaps() -> None:
    assert holes(POLLS, Marks(), USUAL) == []


def test_a_slow_line_has_no_gaps() -> None:
    """255 units at 300 baud respond every three and a half minutes each."""
    times = [i * 213 * SECOND for i in range(20)]
    assert holes(times, Marks(), usual_interval([(at, at, 1) for at in times])) == []


def test_a_reported_loss_makes_a_gap() -> None:
    times = without(4 * SECOND, 8 * SECOND)
    assert holes(times, Marks(lost=[5 * SECOND]), USUAL) == [times.index(4 * SECOND)]


def test_a_short_unreported_pause_is_no_gap() -> None:
    assert holes(without(4 * SECOND, 8 * SECOND), Marks(), USUAL) == []


def test_a_long_pause_is_a_gap_even_when_the_worker_was_gone() -> None:
    times = without(2 * SECOND, 15 * SECOND)
    assert holes(times, Marks(), USUAL) == [times.index(2 * SECOND)]


def test_a_return_after_a_pause_makes_a_gap() -> None:
    times = without(4 * SECOND, 8 * SECOND)
    place = times.index(4 * SECOND)
    assert holes(times, Marks(found=[8 * SECOND]), USUAL) == [place]
    assert holes(times, Marks(found=[8 * SECOND + 100]), USUAL) == [place]
    assert holes(times, Marks(found=[7 * SECOND]), USUAL) == [place]


def test_a_pause_after_the_first_response_is_no_second_gap() -> None:
    """Right after a unit was found its parameters are read."""
    times = [*without(4 * SECOND, 20 * SECOND)[:21], 8 * SECOND, 10 * SECOND, 10 * SECOND + USUAL]
    assert holes(times, Marks(found=[8 * SECOND + 100]), USUAL) == [20]


def test_a_return_without_a_pause_is_no_gap() -> None:
    assert holes(POLLS, Marks(found=[4 * SECOND]), USUAL) == []


def test_a_steady_value_is_read_as_often_as_any() -> None:
    """Runs of a minute each: readings between them carry little information, and may be gaps alone."""
    runs = [(0, 20 * SECOND, 101), (22 * SECOND, 40 * SECOND, 91), (42 * SECOND, 60 * SECOND, 91)]
    assert usual_interval(runs) == USUAL
    assert usual_interval([(0, 0, 1)]) == usual_interval([]) == 0


def test_neighboring_stretches_have_no_gaps() -> None:
    starts = [i * 60 * SECOND for i in range(10)]
    assert holes(starts, Marks(lost=[90 * SECOND]), USUAL, width=60 * SECOND) == []
    assert holes([*starts[:3], *starts[5:]], Marks(), USUAL, width=60 * SECOND) == [2]


def test_losses_outside_of_the_times_make_no_gap() -> None:
    assert holes([10, 20], Marks(lost=[5, 10, 25]), USUAL) == []
    assert holes([], Marks(lost=[5]), USUAL) == []


WORDS = st.lists(st.integers(0, 2), min_size=36, max_size=36)


def polls(words: list[int]) -> list[Run]:
    """One reading every five seconds, three minutes long."""
    times = (position * 5 * SECOND for position in range(len(words)))
    return [Run(at, at, 1, 0, 0, 0, word) for at, word in zip(times, words, strict=True)]


def parts_of(runs: list[Run]) -> list[Interval]:
    return [Interval(run.at, run.until, run.word) for run in runs]


@given(WORDS)
def test_an_interval_holds_one_state_from_first_to_last(words: list[int]) -> None:
    runs = polls(words)
    parts = intervals(parts_of(runs), Marks(), 5 * SECOND)
    assert all(any(p.at <= run.at <= p.until and p.word == run.word for p in parts) for run in runs)
    assert all(a.word != b.word and a.until < b.at for a, b in pairwise(parts))


@given(WORDS, st.permutations([0, 1, 2]))
def test_minutes_in_any_order_make_the_same_intervals(words: list[int], order: list[int]) -> None:
    runs = polls(words)
    stored: list[Interval] = []
    for number in order:
        minute = number * MINUTE
        of_minute = [run for run in runs if run.at // MINUTE == number]
        stored = splice(stored, minute, of_minute, Marks())
    assert stored == intervals(parts_of(runs), Marks(), 5 * SECOND)


def test_one_state_over_three_minutes_is_one_interval_in_every_order() -> None:
    runs = polls([1] * 36)
    for order in permutations(range(3)):
        stored: list[Interval] = []
        for number in order:
            minute = number * MINUTE
            stored = splice(stored, minute, [r for r in runs if r.at // MINUTE == number], Marks())
        assert stored == [Interval(0, runs[-1].at, 1)], order


def test_a_minute_folded_again_changes_nothing() -> None:
    runs = polls([0, 1, 1, 2] * 9)
    stored: list[Interval] = []
    for number in (0, 1, 2, 1):
        stored = splice(stored, number * MINUTE, [r for r in runs if r.at // MINUTE == number], Marks())
    assert stored == intervals(parts_of(runs), Marks(), 5 * SECOND)


def test_a_pause_ends_an_interval() -> None:
    runs = polls([1] * 12)
    lost = Marks(lost=[runs[5].at + SECOND])
    assert intervals(parts_of(runs), lost, 5 * SECOND) == [
        Interval(0, runs[5].at, 1),
        Interval(runs[6].at, runs[11].at, 1),
    ]


def shown(name: str, raw: int, steps: list[tuple[int, int, int]], at: int = 100, **how: object) -> float:
    bus = BUS.model_copy(update=how)
    return scaling(VALUES[name], [ParameterStep(*step) for step in steps], bus).at(at).apply(raw)


def test_decimals_divide_a_raw_speed() -> None:
    assert shown("actual", 12345, [(0, 3, 1)]) == 1234.5


def test_unknown_decimals_leave_the_integer() -> None:
    assert shown("commanded", 12345, []) == 12345
    assert shown("commanded", 12345, [(0, 3, 9)]) == 12345


def test_a_changed_scale_holds_from_when_it_was_read() -> None:
    steps = [(50, 3, 1), (80, 3, 2)]
    assert [shown("actual", 1000, steps, at) for at in (10, 50, 79, 80)] == [100.0, 100.0, 100.0, 10.0]


def test_the_analog_input_spans_low_to_high() -> None:
    steps = [(0, 22, 0), (0, 23, 100)]
    assert [shown("analog", raw, steps) for raw in (0, 51, 255)] == [0.0, 20.0, 100.0]


def test_a_falling_analog_input_is_known_as_such() -> None:
    steps = [ParameterStep(0, 22, 100), ParameterStep(0, 23, 0)]
    assert scaling(VALUES["analog"], steps, BUS).at(0).falling


def test_a_follower_may_speak_in_ratios() -> None:
    steps = [(0, 3, 1), (0, 8, 1)]
    assert shown("commanded", 10_000, steps, follower_speed="ratio") == 1.0
    assert shown("commanded", 10_000, steps, follower_speed="speed") == 1000.0
    assert shown("commanded", 10_000, [(0, 3, 1), (0, 8, 0)], follower_speed="ratio") == 1000.0


def test_an_emergency_stop_is_one_when_it_is_active() -> None:
    assert [shown("estop", raw, []) for raw in (0, 1)] == [1.0, 0.0]
    assert [shown("estop", raw, [], estop_healthy=0) for raw in (0, 1)] == [0.0, 1.0]
    assert [shown("run", raw, []) for raw in (0, 1)] == [0.0, 1.0]

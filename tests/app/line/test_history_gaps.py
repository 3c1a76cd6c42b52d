"""Gaps: missing responses make one, an unchanged value or a slow line does not."""

from __future__ import annotations

from app.line.history.series.runs import SECOND
from app.line.history.series.values import Marks, holes, usual_interval

POLLS = [i * SECOND // 5 for i in range(100)]
USUAL = SECOND // 5


def without(start: int, end: int) -> list[int]:
    return [at for at in POLLS if not start < at < end]


def test_regular_polls_have_none() -> None:
    assert holes(POLLS, Marks(), USUAL) == []


def test_a_slow_line_has_none() -> None:
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


def test_neighbouring_stretches_have_none() -> None:
    starts = [i * 60 * SECOND for i in range(10)]
    assert holes(starts, Marks(lost=[90 * SECOND]), USUAL, width=60 * SECOND) == []
    assert holes([*starts[:3], *starts[5:]], Marks(), USUAL, width=60 * SECOND) == [2]


def test_marks_outside_do_not_matter() -> None:
    assert holes([10, 20], Marks(lost=[5, 10, 25]), USUAL) == []
    assert holes([], Marks(lost=[5]), USUAL) == []

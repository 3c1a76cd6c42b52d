"""When two neighboring readings have a hole between them. An unchanged value is no hole.

A hole is where the worker reported that the unit or its port stopped responding. Where it could not
(the worker itself was gone, its buffer overflowed) the length of the gap decides.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import sub

from app.history.series.runs import SECOND

LONG_GAP = 10 * SECOND
MANY_INTERVALS = 10
"""A gap longer than both is a hole in any case."""
SHORT_GAP = 3 * SECOND // 10
FEW_INTERVALS = 3
"""A gap longer than both is a hole when the unit or port was found again at its end."""
_SAMPLE = 2000


@dataclass(frozen=True, slots=True)
class Marks:
    """Reported states of a unit and its port, as times in µs, in order."""

    lost: Sequence[int] = ()
    found: Sequence[int] = ()


def usual_interval(runs: Sequence[Sequence[int]]) -> int:
    """How often a unit responds, µs, from its runs (``at``, ``until``, ``readings``, … each); 0: too few.

    The readings within a run count as well: of a steady value there is nothing between runs but holes.
    """
    sample = runs[:_SAMPLE]
    if not sample:
        return 0
    at, until, readings, *_ = zip(*sample, strict=True)
    lengths = sorted(map(sub, at[1:], until))
    if readings.count(1) == len(readings):
        return lengths[(len(lengths) - 1) // 2] if lengths else 0
    spans = [(length, 1) for length in lengths]
    spans += [((run[1] - run[0]) // (run[2] - 1), run[2] - 1) for run in sample if run[2] > 1]
    return _middle(sorted(spans))


def _middle(spans: Iterable[tuple[int, int]]) -> int:
    """The median of lengths in order, each with how often it is there."""
    spans = list(spans)
    left = sum(often for _, often in spans) / 2
    for length, often in spans:
        left -= often
        if left <= 0:
            return length
    return 0


def short_gap(usual: int) -> int:
    """The longest gap, µs, that no hole is without a report of a loss. ``usual``: how often
    the unit responds, µs."""
    return max(SHORT_GAP, FEW_INTERVALS * usual)


def long_gap(usual: int) -> int:
    """The longest gap, µs, that may be no hole. ``usual``: how often the unit responds, µs."""
    return max(LONG_GAP, MANY_INTERVALS * usual)


def holes(times: Sequence[int], marks: Marks, usual: int, width: int = 0) -> list[int]:
    """Positions ``i`` with a hole between ``times[i]`` and ``times[i + 1]`` (in order).

    ``width``: a time represents all readings within so many µs after it.
    """
    differences = list(map(sub, times[1:], times))
    short = width + short_gap(usual)
    if not marks.lost and max(differences, default=0) <= short:
        return []
    limit = width + long_gap(usual)
    found = {i for i, difference in enumerate(differences) if difference > limit}
    lost = {bisect_left(times, mark) - 1 for mark in marks.lost}
    found |= {i for i in lost if 0 <= i < len(differences) and differences[i] > width}
    # A gap ended before the reading just before the mark, before that of the mark, or before the next.
    last = [(mark, bisect_right(times, mark) - 1) for mark in marks.found]
    ended = {i - 1 if i >= 0 and mark - times[i] <= usual else i for mark, i in last}
    found |= {i for i in ended if 0 <= i < len(differences) and differences[i] > short}
    return sorted(found)

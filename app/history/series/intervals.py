"""Bits as exact intervals: from the first reading with the bit to the last one in a row."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate, pairwise
from typing import NamedTuple

from app.history.series.gaps import Marks, holes, usual_interval
from app.history.series.runs import MINUTE, PlainRun


class Interval(NamedTuple):
    """All bits of a unit (ST2 * 256 + ST1), the same from ``at`` until ``until`` (µs)."""

    at: int
    until: int
    word: int


def intervals(parts: Iterable[tuple[int, int, int]], marks: Marks, usual: int = 0) -> list[Interval]:
    """Neighbours with the same bits and no hole between them as one, in order of time."""
    ordered = sorted(parts)
    if not ordered:
        return []
    starts, ends, words = zip(*ordered, strict=True)
    reach = list(accumulate(ends, max))
    begins = map(max, starts, (0, *reach))
    edges = [time for pair in zip(begins, reach, strict=True) for time in pair]
    broken = {i // 2 + 1 for i in holes(edges, marks, usual) if i % 2}
    changed = {i for i, (before, word) in enumerate(pairwise(words), 1) if word != before}
    cuts = sorted({0, len(ordered)} | broken | changed)
    return [Interval(starts[i], max(ends[i:j]), words[i]) for i, j in pairwise(cuts)]


def splice(stored: Sequence[Interval], minute: int, runs: Sequence[PlainRun], marks: Marks) -> list[Interval]:
    """Return the replacement of ``stored``, the intervals that touch a minute or are next to it,
    now that all runs of that minute are known."""
    after = minute + MINUTE
    around = [part._replace(until=min(part.until, minute - 1)) for part in stored if part.at < minute]
    around += [part._replace(at=max(part.at, after)) for part in stored if part.until >= after]
    return intervals([*around, *((run[0], run[1], run[6]) for run in runs)], marks, usual_interval(runs))

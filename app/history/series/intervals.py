"""Bits as exact intervals: from the first reading with the bit to the last one in a row."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate, compress, count, pairwise
from operator import itemgetter, ne, sub
from typing import NamedTuple

from app.history.series.gaps import Marks, holes, short_gap, usual_interval
from app.history.series.runs import MINUTE, PlainRun, Run

_PART = itemgetter(*(Run._fields.index(name) for name in ("at", "until", "word")))
"""Of a run, the fields of an interval."""


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
    changed = compress(count(1), map(ne, words[1:], words))
    cuts = sorted({0, len(ordered), *_broken(starts, list(accumulate(ends, max)), marks, usual), *changed})
    return [Interval(starts[i], max(ends[i:j]), words[i]) for i, j in pairwise(cuts)]


def _broken(starts: Sequence[int], reach: Sequence[int], marks: Marks, usual: int) -> set[int]:
    """Which parts have a hole before them. ``reach``: where all parts up to each have ended."""
    # As a rule there is none, and each minute of each unit passes here.
    if not marks.lost and max(map(sub, starts[1:], reach), default=0) <= short_gap(usual):
        return set()
    begins = map(max, starts, (0, *reach))
    edges = [time for pair in zip(begins, reach, strict=True) for time in pair]
    return {i // 2 + 1 for i in holes(edges, marks, usual) if i % 2}


def splice(stored: Sequence[Interval], minute: int, runs: Sequence[PlainRun], marks: Marks) -> list[Interval]:
    """Return the replacement of ``stored``, the intervals that touch a minute or are next to it,
    now that all runs of that minute are known."""
    after = minute + MINUTE
    around = [part._replace(until=min(part.until, minute - 1)) for part in stored if part.at < minute]
    around += [part._replace(at=max(part.at, after)) for part in stored if part.until >= after]
    return intervals([*around, *map(_PART, runs)], marks, usual_interval(runs))

"""Bits as exact intervals: from the first reading that said so to the last one in a row."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from operator import sub
from typing import NamedTuple

from app.history.gaps import Marks, holes, usual_interval
from app.history.runs import MINUTE, Run


class Interval(NamedTuple):
    """All bits of a unit (ST2 * 256 + ST1), the same from ``at`` until ``until`` (µs)."""

    at: int
    until: int
    word: int


def intervals(parts: Iterable[Run | Interval], marks: Marks, usual: int = 0) -> list[Interval]:
    """Neighbours with the same bits and no hole between them as one, in order of time."""
    ordered = sorted(Interval(part.at, part.until, _word(part)) for part in parts)
    ends = [time for part in ordered for time in (part.at, part.until)]
    broken = {i // 2 for i in holes(ends, marks, usual) if i % 2} if _rising(ends) else set()
    joined: list[Interval] = []
    for position, part in enumerate(ordered):
        if joined and joined[-1].word == part.word and position - 1 not in broken:
            joined[-1] = joined[-1]._replace(until=max(joined[-1].until, part.until))
        else:
            joined.append(part)
    return joined


def splice(stored: Sequence[Interval], minute: int, runs: Sequence[Run], marks: Marks) -> list[Interval]:
    """What takes the place of ``stored``: the intervals that touch a minute or are next to it,
    now that all runs of that minute are known."""
    after = minute + MINUTE
    around = [part._replace(until=min(part.until, minute - 1)) for part in stored if part.at < minute]
    around += [part._replace(at=max(part.at, after)) for part in stored if part.until >= after]
    usual = usual_interval([b.at - a.until for a, b in pairwise(runs)])
    return intervals([*around, *runs], marks, usual)


def _word(part: Run | Interval) -> int:
    return part.word


def _rising(times: Sequence[int]) -> bool:
    return all(step >= 0 for step in map(sub, times[1:], times))

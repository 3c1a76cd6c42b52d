"""Summary of a minute or an hour: how many readings, and of each value the least, the greatest
and the sum; of the bits, which were ever off, which ever on, and how often each was on.

Sums and counts are exact integers: an hour made of minutes equals the hour made of readings.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from functools import reduce
from operator import and_, mul, or_
from typing import NamedTuple

from app.line.history.series import columns
from app.line.history.series.runs import MINUTE, PlainRun

BITS = 16
"""ST2 * 256 + ST1, as in :class:`app.line.history.series.runs.Run`."""


class Rollup(NamedTuple):
    """One unit over one minute or hour. ``start`` in µs since the epoch, values as on the wire."""

    start: int
    readings: int
    commanded_min: int
    commanded_max: int
    commanded_sum: int
    actual_min: int
    actual_max: int
    actual_sum: int
    analog_min: int
    analog_max: int
    analog_sum: int
    word_and: int
    """Bits that were on in every reading."""
    word_or: int
    """Bits that were on in any."""
    on: tuple[int, ...]
    """For each bit, in how many readings it was on."""


_PLAIN = len(Rollup._fields) - 1
FIELDS = {name: position for position, name in enumerate(Rollup._fields[:-1])} | {
    f"on_{bit}": _PLAIN + bit for bit in range(BITS)
}
"""Position of each column in a packed row of rollups."""


def rollup(runs: Sequence[PlainRun], start: int) -> Rollup:
    """Readings of one unit, at least one, as one row."""
    return _rollup(list(zip(*runs, strict=True)), start)


def minute_rollups(table: Sequence[Sequence[int]]) -> list[Rollup]:
    """Each minute of the columns of runs, in order of time, as one row."""
    at, rows, first = table[0], [], 0
    while first < len(at):
        minute = at[first] - at[first] % MINUTE
        last = bisect_left(at, minute + MINUTE, first)
        rows.append(_rollup([column[first:last] for column in table], minute))
        first = last
    return rows


def _rollup(table: Sequence[Sequence[int]], start: int) -> Rollup:
    _, _, counts, commanded, actual, analog, words = table
    weights = {words[0]: sum(counts)}
    if words.count(words[0]) < len(words):
        weights = dict.fromkeys(words, 0)
        for word, count in zip(words, counts, strict=True):
            weights[word] += count
    return Rollup(
        start,
        sum(counts),
        *_reach(commanded, counts),
        *_reach(actual, counts),
        *_reach(analog, counts),
        reduce(and_, weights),
        reduce(or_, weights),
        _counts(weights.items()),
    )


def _reach(values: Sequence[int], counts: Sequence[int]) -> tuple[int, int, int]:
    return min(values), max(values), sum(map(mul, values, counts))


def _counts(words: Iterable[tuple[int, int]]) -> tuple[int, ...]:
    """For each bit, how many readings have it, of words and how many readings have each."""
    on = [0] * BITS
    for word, count in words:
        for bit in range(BITS):
            if word >> bit & 1:
                on[bit] += count
    return tuple(on)


def combine(rows: Sequence[Rollup], start: int) -> Rollup:
    """Combine rows, at least one, into one of a longer time."""
    _, readings, *plain, words_and, words_or, on = zip(*rows, strict=True)
    reaches = [
        reach
        for least, greatest, total in zip(plain[0::3], plain[1::3], plain[2::3], strict=True)
        for reach in (min(least), max(greatest), sum(total))
    ]
    bits = tuple(sum(column) for column in zip(*on, strict=True))
    words = reduce(and_, words_and), reduce(or_, words_or)
    return Rollup._make([start, sum(readings), *reaches, *words, bits])


def pack_rollups(rows: Sequence[Rollup], start: int) -> bytes:
    """Rows of one unit, in order of time, as a block; times are kept relative to ``start``."""
    starts, *plain, on = zip(*rows, strict=True)
    return columns.pack([[t - start for t in starts], *plain, *zip(*on, strict=True)])


def unpack_rollups(blob: bytes, start: int) -> list[Rollup]:
    """The rows of a block. Raises ValueError when it is damaged."""
    rows = zip(*columns.unpack(blob), strict=True)
    return [Rollup._make([start + row[0], *row[1:_PLAIN], row[_PLAIN:]]) for row in rows]


def replace_rows(rows: Iterable[Rollup], newer: Iterable[Rollup]) -> list[Rollup]:
    """``rows`` in order of time, each of ``newer`` instead of the one at its start, or beside the others."""
    by_start = {row.start: row for each in (rows, newer) for row in each}
    return sorted(by_start.values())

"""Any number of readings as at most so many points: least, greatest and average of each stretch.

Buckets lie on a grid of round widths that does not move with the span, so a picture that is
drawn again a second later does not dance.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import itemgetter, le, truediv

from app.line.history.series.runs import DAY, HOUR, MINUTE, SECOND
from app.line.history.series.values import Marks, Scaling, holes

_MS = 1000
WIDTHS = tuple(
    unit * factor
    for unit, factors in (
        (_MS, (1, 2, 5, 10, 20, 50, 100, 200, 500)),
        (SECOND, (1, 2, 5, 10, 15, 20, 30)),
        (MINUTE, (1, 2, 3, 5, 10, 15, 20, 30)),
        (HOUR, (1, 2, 3, 4, 6, 8, 12)),
        (DAY, (1, 2, 4, 7, 14, 28, 56, 91, 182, 364)),
    )
    for factor in factors
)
"""Round widths, µs."""


@dataclass(slots=True)
class Points:
    """Readings or stretches in order of time. Raw values; ``weight`` counts readings."""

    at: list[int] = field(default_factory=list)
    least: list[int] = field(default_factory=list)
    greatest: list[int] = field(default_factory=list)
    total: list[int] = field(default_factory=list)
    weight: list[int] = field(default_factory=list)
    solid: list[bool] = field(default_factory=list)
    """Whether the value is known without a gap until the next point."""
    width: int = 0
    """Length of the stretch of each point, µs; 0: single readings."""
    usual: int = 0
    """The usual interval between two responses of the unit, µs."""


@dataclass(slots=True)
class Series:
    """The points of a chart, in display units; None is a hole."""

    at: list[int] = field(default_factory=list)
    least: list[float | None] = field(default_factory=list)
    greatest: list[float | None] = field(default_factory=list)
    average: list[float | None] = field(default_factory=list)


def downsample(points: Points, start: int, end: int, most: int) -> Points:
    """Reduce points to at most ``most`` buckets between ``start`` and ``end``, µs."""
    width, origin = grid(start, end, most, points.width or _MS)
    parts = _parts(points.at, origin, width)
    return Points(
        at=[max(points.at[i] - (points.at[i] - origin) % width, start) for i, _ in parts],
        least=[min(points.least[i:j]) for i, j in parts],
        greatest=[max(points.greatest[i:j]) for i, j in parts],
        total=[sum(points.total[i:j]) for i, j in parts],
        weight=[sum(points.weight[i:j]) for i, j in parts],
        solid=[points.solid[j - 1] for _, j in parts],
        width=width,
        usual=points.usual,
    )


def _parts(at: Sequence[int], origin: int, width: int) -> list[tuple[int, int]]:
    """The range of positions of each bucket, without the empty ones."""
    parts = []
    i, n = 0, len(at)
    while i < n:
        j = bisect_left(at, at[i] - (at[i] - origin) % width + width, i)
        parts.append((i, j))
        i = j
    return parts


def grid(start: int, end: int, most: int, least_width: int = _MS) -> tuple[int, int]:
    """Width and origin of at most ``most`` buckets over a span, µs; multiples of a time unit if possible."""
    for width in WIDTHS:
        if width % least_width == 0 and -(-end // width) - start // width <= most:
            return width, 0
    return max(least_width, -(-(end - start) // most)), start


def series(points: Points, marks: Marks, scaling: Scaling) -> Series:
    """Return the points in display units, with the holes."""
    result = Series(points.at)
    for i, j, scale in scaling.stretches(points.at):
        low, high = scale.apply_all(points.least[i:j]), scale.apply_all(points.greatest[i:j])
        middle = scale.apply_all(map(truediv, points.total[i:j], points.weight[i:j]))
        result.least += high if scale.falling else low
        result.greatest += low if scale.falling else high
        # Where nothing moved, the exact value and not its divided sum.
        result.average += [a if a == b else round(m, 6) for a, b, m in zip(low, high, middle, strict=True)]
    return _opened(result, holes_in(points, marks), points.width)


def _opened(series: Series, after: Sequence[int], width: int) -> Series:
    """Return a series with a null between the points of each hole."""
    if not after:
        return series
    times = [series.at[i] + max(width, (series.at[i + 1] - series.at[i]) // 2) for i in after]
    at, nothing = series.at + times, [None] * len(times)
    ordered = itemgetter(*sorted(range(len(at)), key=at.__getitem__))
    least, greatest = ordered(series.least + nothing), ordered(series.greatest + nothing)
    return Series(list(ordered(at)), list(least), list(greatest), list(ordered(series.average + nothing)))


def holes_in(points: Points, marks: Marks) -> list[int]:
    """After which points there is a hole."""
    found = holes(points.at, marks, points.usual, points.width)
    return [i for i in found if not points.solid[i]]


def in_order(points: Points) -> Points:
    """Sort points by time: where a clock was set back or a minute came late, two stretches overlap."""
    if all(map(le, points.at, points.at[1:])):
        return points
    order = sorted(range(len(points.at)), key=points.at.__getitem__)
    columns = (points.at, points.least, points.greatest, points.total, points.weight)
    at, least, greatest, total, weight = ([column[i] for i in order] for column in columns)
    solid = [points.solid[i] for i in order]
    return Points(at, least, greatest, total, weight, solid, points.width, points.usual)

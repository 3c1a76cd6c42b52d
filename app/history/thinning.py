"""Any number of readings as at most so many points: least, greatest and average of each stretch.

Buckets lie on a grid of round widths that does not move with the span, so a picture that is
drawn again a second later does not dance.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field

from app.history.gaps import Marks, holes
from app.history.runs import DAY, HOUR, MINUTE, SECOND
from app.history.scaling import Scaling

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
    """Whether the value was heard all the while until the next point."""
    width: int = 0
    """How long a stretch each point stands for, µs; 0: the readings themselves."""
    usual: int = 0
    """How often the unit is heard, µs."""


@dataclass(slots=True)
class Series:
    """What is drawn, in display units; None is a hole."""

    at: list[int] = field(default_factory=list)
    least: list[float | None] = field(default_factory=list)
    greatest: list[float | None] = field(default_factory=list)
    average: list[float | None] = field(default_factory=list)


def thin(points: Points, start: int, end: int, most: int) -> Points:
    """The same in at most ``most`` buckets between ``start`` and ``end``, µs."""
    width, origin = grid(start, end, most, points.width or _MS)
    result = Points(width=width, usual=points.usual)
    i, n = 0, len(points.at)
    while i < n:
        bucket = (points.at[i] - origin) // width
        j = bisect_left(points.at, origin + (bucket + 1) * width, i)
        result.at.append(max(origin + bucket * width, start))
        result.least.append(min(points.least[i:j]))
        result.greatest.append(max(points.greatest[i:j]))
        result.total.append(sum(points.total[i:j]))
        result.weight.append(sum(points.weight[i:j]))
        result.solid.append(points.solid[j - 1])
        i = j
    return result


def grid(start: int, end: int, most: int, least_width: int = _MS) -> tuple[int, int]:
    """Width and origin of at most ``most`` buckets over a span, µs. A round width where one fits."""
    for width in WIDTHS:
        if width % least_width == 0 and -(-end // width) - start // width <= most:
            return width, 0
    return max(least_width, -(-(end - start) // most)), start


def series(points: Points, marks: Marks, scaling: Scaling) -> Series:
    """In display units, with the holes."""
    result = Series()
    open_after = set(holes_in(points, marks))
    rows = zip(points.at, points.least, points.greatest, points.total, points.weight, strict=True)
    for i, (at, least, greatest, total, weight) in enumerate(rows):
        scale = scaling.at(at)
        low, high = scale.apply(least), scale.apply(greatest)
        result.at.append(at)
        result.least.append(high if scale.falling else low)
        result.greatest.append(low if scale.falling else high)
        result.average.append(low if least == greatest else round(scale.apply(total / weight), 6))
        if i in open_after:
            _open(result, at + max(points.width, (points.at[i + 1] - at) // 2))
    return result


def _open(result: Series, at: int) -> None:
    result.at.append(at)
    for column in (result.least, result.greatest, result.average):
        column.append(None)


def holes_in(points: Points, marks: Marks) -> list[int]:
    """After which points there is a hole."""
    found = holes(points.at, marks, points.usual, points.width)
    return [i for i in found if not points.solid[i]]


def in_order(points: Points) -> Points:
    """By time: where a clock was set back or a minute came late, two stretches lie over each other."""
    if all(a <= b for a, b in zip(points.at, points.at[1:], strict=False)):
        return points
    order = sorted(range(len(points.at)), key=points.at.__getitem__)
    columns = (points.at, points.least, points.greatest, points.total, points.weight)
    at, least, greatest, total, weight = ([column[i] for i in order] for column in columns)
    solid = [points.solid[i] for i in order]
    return Points(at, least, greatest, total, weight, solid, points.width, points.usual)

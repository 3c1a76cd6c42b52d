"""The draw of a section over time, from the stored actual speeds of it and of the section before. Pure."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from app.history.series.downsampling import Series
from app.history.series.runs import MINUTE
from app.history.series.values import LONG_GAP

STORED_DECIMALS = 2


class SpeedStretch(NamedTuple):
    """A speed from one time until another, µs."""

    at: int
    until: int
    speed: float


class DrawFigures(NamedTuple):
    """In percent: of all web that passed, and of the minutes with the least and the greatest draw."""

    average: float
    least: float
    greatest: float


def draw_figures(before: Sequence[SpeedStretch], section: Sequence[SpeedStretch]) -> DrawFigures | None:
    """The draw of a section over the time in which both it and the section before have a speed, which is not
    0; None where they never have one at the same time. Each in order of time."""
    minutes: dict[int, tuple[float, float]] = {}
    for at, until, speed_before, speed in _together(before, section):
        passed, went = minutes.get(at // MINUTE, (0.0, 0.0))
        lasting = until - at
        minutes[at // MINUTE] = passed + speed_before * lasting, went + speed * lasting
    if not minutes:
        return None
    draws = [_draw(*lengths) or 0.0 for lengths in minutes.values()]
    passed, went = (sum(lengths) for lengths in zip(*minutes.values(), strict=True))
    return DrawFigures(_draw(passed, went) or 0.0, min(draws), max(draws))


def _together(
    before: Sequence[SpeedStretch], section: Sequence[SpeedStretch]
) -> Iterator[tuple[int, int, float, float]]:
    """The time that both cover, piece by piece, with both speeds."""
    i = j = 0
    while i < len(before) and j < len(section):
        one, other = before[i], section[j]
        at, until = max(one.at, other.at), min(one.until, other.until)
        if until > at:
            yield at, until, one.speed, other.speed
        if one.until <= other.until:
            i += 1
        else:
            j += 1


def draw_series(before: Series, section: Series, width: int) -> Series:
    """In percent, at each time at which either speed has a point; None while either stands or has a hole.

    ``width``: length of the stretch that a point stands for, µs, 0 for single readings. The draw of a stretch
    is that of its averages, so of the lengths of web that passed: least and greatest are equal to it.
    """
    at = sorted({*before.at, *section.at})
    speed_before, speed = _held(before, width), _held(section, width)
    draws = [_draw(speed_before(time), speed(time)) for time in at]
    return Series(at, draws, list(draws), list(draws))


def _held(series: Series, width: int) -> Callable[[int], float | None]:
    """The speed at a time: that of the last point, until the next one or, after the last, for as long as a
    hole may be."""
    times, speeds = series.at, series.average

    def at(time: int) -> float | None:
        place = bisect_right(times, time) - 1
        is_over = place == len(times) - 1 and time - times[-1] > width + LONG_GAP
        return None if place < 0 or is_over else speeds[place]

    return at


def _draw(before: float | None, section: float | None) -> float | None:
    return round(100 * (section / before - 1), STORED_DECIMALS) if before and section else None

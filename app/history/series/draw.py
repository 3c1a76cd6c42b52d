"""The draw of a section over time, from the stored actual speeds of it and of the section before. Pure."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable

from app.history.series.downsampling import Series
from app.history.series.gaps import LONG_GAP

STORED_DECIMALS = 2


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

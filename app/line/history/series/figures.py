"""Figures of a unit: how long it ran and was at speed, when and why it stood still, how far it went, and its
draw. Pure.

A unit runs while its actual speed is not 0. It is at speed while it runs with a setpoint above 0 and reports
the bit *at speed* of ST2: its actual speed is within the window of parameter 12 around the commanded one, as
the line shows it and the condition ``not_at_speed`` judges it. A reading counts until the next one, unless
there is a hole between, which counts as neither."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from operator import itemgetter
from typing import Literal, NamedTuple

from app.line.history.series.downsampling import Series
from app.line.history.series.rollup import Rollup
from app.line.history.series.runs import MINUTE, Run
from app.line.history.series.values import LONG_GAP, VALUES, Marks, Scaling, holes, usual_interval
from bus.catalogue.values import status_bits

StopCause = Literal["estop", "run_off", "speed_zero", "unknown"]
SpeedOf = Callable[[int, int], float]
"""The speed that a raw value stood for at a time, µs."""
_AT_SPEED = 1 << VALUES["at_speed"].bit


@dataclass(slots=True)
class Stop:
    """From when to when a unit stood still, µs, and what its first reading then shows as the cause."""

    at: int
    until: int
    cause: StopCause


@dataclass(slots=True)
class RunFigures:
    """``known``: for how long there are readings; ``running``: for how long of that it ran; ``at_speed``: for
    how long of that it was at speed, all µs; ``travel``: speed times µs; ``fastest``: the greatest speed;
    ``by_minute``: from averages of minutes, and not from each reading."""

    known: int = 0
    running: int = 0
    at_speed: int = 0
    travel: float = 0.0
    fastest: float = 0.0
    stops: list[Stop] = field(default_factory=list)
    by_minute: bool = False


class RunStretch(NamedTuple):
    """For how long a run of readings counts, µs."""

    at: int
    until: int
    run: Run

    @property
    def is_at_speed(self) -> bool:
        return _is_at_speed(self.run)


def _is_at_speed(run: Run) -> bool:
    return bool(run.actual and run.commanded > 0 and run.word & _AT_SPEED)


def run_figures(stretches: Iterable[RunStretch], estop_healthy: int, speed_of: SpeedOf) -> RunFigures:
    """The figures of a unit from its readings, in order of time."""
    figures = RunFigures()
    stop: Stop | None = None
    for stretch in stretches:
        at, until, run = stretch
        figures.known += until - at
        if run.actual:
            speed = speed_of(at, run.actual)
            figures.running += until - at
            figures.travel += speed * (until - at)
            figures.fastest = max(figures.fastest, speed)
            figures.at_speed += until - at if stretch.is_at_speed else 0
            stop = None
        elif stop is None:
            stop = Stop(at, until, _cause(run, estop_healthy))
            figures.stops.append(stop)
        else:
            stop.until = until
    return figures


def runs_of_minutes(minutes: Iterable[Rollup]) -> list[Run]:
    """Each minute as one run of its averages; a unit that moved at all ran, and one that was at speed in each
    reading was at speed."""
    return [
        Run(
            at=each.start,
            until=each.start + MINUTE,
            readings=each.readings,
            commanded=-(-each.commanded_sum // each.readings),
            actual=-(-each.actual_sum // each.readings),
            analog=0,
            word=each.word_and,
        )
        for each in minutes
    ]


def stretches(runs: Sequence[Run], start: int, end: int, marks: Marks) -> list[RunStretch]:
    """The runs of a unit over a span, µs, in order of time, each up to the next or to the hole after it.
    Runs from outside of the span show how long those at its ends count."""
    found = []
    for run, until in zip(runs, _ends(runs, marks), strict=True):
        at, until = max(run.at, start), min(until, end)
        if until > at:
            found.append(RunStretch(at, until, run))
    return found


def _ends(runs: Sequence[Run], marks: Marks) -> list[int]:
    """Return until when each run counts, µs: up to the next run, or to the hole after it."""
    edges = list(chain.from_iterable(map(itemgetter(0, 1), runs)))
    ends = [*edges[2::2], *edges[-1:]]
    for position in holes(edges, marks, usual_interval(runs)):
        if position % 2:
            ends[position // 2] = edges[position]
    return ends


def minute_figures(runs: Sequence[Run], marks: Marks, scales: Scaling) -> dict[int, RunFigures]:
    """Return the figures of each minute by its beginning, µs, without stops and the greatest speed. What
    lasts over the end of a minute is divided."""
    lasting: defaultdict[tuple[int, int, int, bool], int] = defaultdict(int)
    since = scales.since
    for run, until in zip(runs, _ends(runs, marks), strict=True):
        at, actual, is_at_speed = run.at, run.actual, _is_at_speed(run)
        place = bisect_right(since, at)
        while until > (end := at - at % MINUTE + MINUTE):
            lasting[end, place, actual, is_at_speed] += end - at
            at = end
        lasting[end, place, actual, is_at_speed] += until - at
    found: dict[int, RunFigures] = {}
    for (end, place, raw, is_at_speed), each in lasting.items():
        figures = found.setdefault(end - MINUTE, RunFigures())
        figures.known += each
        if raw:
            figures.running += each
            figures.travel += scales.scales[max(0, place - 1)].apply(raw) * each
            figures.at_speed += each if is_at_speed else 0
    return found


def _cause(run: Run, estop_healthy: int) -> StopCause:
    bits = status_bits(run.word >> 8, run.word & 255, estop_healthy)
    if bits.estop_active:
        return "estop"
    if not bits.run:
        return "run_off"
    return "speed_zero" if run.commanded == 0 else "unknown"


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

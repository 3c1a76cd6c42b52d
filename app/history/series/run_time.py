"""How long a unit ran and was at speed, when it stood still and why, and how far it went. Pure.

A unit runs while its actual speed is not 0. It is at speed while it runs with a setpoint above 0 and reports
the bit *at speed* of ST2: its actual speed is within the window of parameter 12 around the commanded one, as
the line shows it and the condition ``not_at_speed`` judges it. A reading counts until the next one, unless
there is a hole between, which counts as neither."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Literal, NamedTuple

from app.history.series.rollup import Rollup
from app.history.series.runs import MINUTE, Run
from app.history.series.values import VALUES, Marks, holes, usual_interval
from bus.catalogue.status import status_bits

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
        run = self.run
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
    edges = [time for run in runs for time in (run.at, run.until)]
    broken = {position // 2 for position in holes(edges, marks, usual_interval(runs)) if position % 2}
    found = []
    for position, (run, following) in enumerate(zip_longest(runs, runs[1:])):
        lasts = run.until if following is None or position in broken else following.at
        at, until = max(run.at, start), min(lasts, end)
        if until > at:
            found.append(RunStretch(at, until, run))
    return found


def _cause(run: Run, estop_healthy: int) -> StopCause:
    bits = status_bits(run.word >> 8, run.word & 255, estop_healthy)
    if bits.estop_active:
        return "estop"
    if not bits.run:
        return "run_off"
    return "speed_zero" if run.commanded == 0 else "unknown"

"""How long a unit ran, when it stood still and why, and how far it went. Pure.

A unit runs while its actual speed is not 0. A reading counts until the next one, unless there is a hole
between."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Literal, NamedTuple

from app.history.series.gaps import long_gap, usual_interval
from app.history.series.rollup import Rollup
from app.history.series.runs import MINUTE, Run
from bus.catalogue.status import status_bits

StopCause = Literal["estop", "run_off", "speed_zero", "unknown"]
SpeedOf = Callable[[int, int], float]
"""The speed that a raw value stood for at a time, µs."""


@dataclass(slots=True)
class Stop:
    """From when to when a unit stood still, µs, and what its first reading then shows as the cause."""

    at: int
    until: int
    cause: StopCause


@dataclass(slots=True)
class RunFigures:
    """``known``: for how long there are readings; ``running``: for how long of that it ran, both µs;
    ``travel``: speed times µs; ``by_minute``: from averages of minutes, since the readings are not kept."""

    known: int = 0
    running: int = 0
    travel: float = 0.0
    stops: list[Stop] = field(default_factory=list)
    by_minute: bool = False


class _Stretch(NamedTuple):
    at: int
    until: int
    run: Run


def run_figures(
    runs: Sequence[Run], start: int, end: int, estop_healthy: int, speed_of: SpeedOf
) -> RunFigures:
    """The figures of the runs of a unit over a span, µs, in order of time."""
    figures = RunFigures()
    stop: Stop | None = None
    for at, until, run in _stretches(runs, start, end):
        figures.known += until - at
        if run.actual:
            figures.running += until - at
            figures.travel += speed_of(at, run.actual) * (until - at)
            stop = None
        elif stop is None:
            stop = Stop(at, until, _cause(run, estop_healthy))
            figures.stops.append(stop)
        else:
            stop.until = until
    return figures


def runs_of_minutes(minutes: Iterable[Rollup]) -> list[Run]:
    """Each minute as one run of its averages; a unit that moved at all ran."""
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


def _stretches(runs: Sequence[Run], start: int, end: int) -> Iterator[_Stretch]:
    longest = long_gap(usual_interval(runs))
    for run, following in zip_longest(runs, runs[1:]):
        goes_on = following is not None and following.at - run.until <= longest
        at, until = max(run.at, start), min(following.at if goes_on else run.until, end)
        if until > at:
            yield _Stretch(at, until, run)


def _cause(run: Run, estop_healthy: int) -> StopCause:
    bits = status_bits(run.word >> 8, run.word & 255, estop_healthy)
    if bits.estop_active:
        return "estop"
    if not bits.run:
        return "run_off"
    return "speed_zero" if run.commanded == 0 else "unknown"

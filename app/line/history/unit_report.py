"""The report on what units did over a span, from the store."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby

from app.line.history import tables
from app.line.history.query import (
    SeriesQuery,
    StoredUnit,
    has_raw,
    runs_between,
    scale_of,
    speed_minutes,
    stored_unit,
)
from app.line.history.recorder import Tail
from app.line.history.series.figures import (
    DrawFigures,
    RunFigures,
    RunStretch,
    SpeedMinute,
    SpeedStretch,
    draw_figures,
    run_figures,
    stretches,
)
from app.line.history.series.runs import HOUR, MINUTE
from app.line.history.series.values import VALUES, Marks, ParameterStep, Scaling
from bus.catalogue.parameters import FOLLOWER_MODE
from bus.settings import BusSettings

MAX_READINGS = 200_000
"""With more readings in unsteady minutes a report uses averages for them: 100,000 take a second."""
MAX_READINGS_OF_UNIT = 40_000
"""Two hours of readings at 9600 baud on a bus of eight, and so some fifty starts and stops."""
ENOUGH = 0.92
"""A minute with a smaller part of the readings of the fullest one may have half of a hole in it."""


@dataclass(frozen=True, slots=True)
class UnitReport:
    """The figures of a unit, and its draw to the unit before; None without one, or if the two were never at
    speed at the same time."""

    unit: int
    runs: RunFigures | None
    """None for a follower whose speeds are ratios, which do not show whether it runs."""
    draw: DrawFigures | None = None


@dataclass(frozen=True, slots=True)
class _Speeds:
    """The speeds of a unit while it was at speed. ``decimals``: those of its display; None if not known."""

    stretches: list[SpeedStretch] = field(default_factory=list)
    decimals: int | None = None


def stored_tail(connection: tables.StoreConnection) -> Tail:
    """Read the journal into a tail, as a server does at its start, without changing anything."""
    tail = Tail()
    for rows in tables.read_journal(connection):
        tail.add(rows or ())
    return tail


class BusReport:
    """The figures of the units of a bus, or ``only`` one of them, over a span, µs. Each unit is read by
    itself, so that no read takes long."""

    def __init__(
        self, bus: BusSettings, only: int | None, span: tuple[int, int], max_readings: int = MAX_READINGS
    ) -> None:
        wanted = {unit.id for unit in bus.unit if only in (None, unit.id)}
        needed = wanted | {bus.seams[unit].before for unit in wanted if unit in bus.seams}
        self.units = [unit.id for unit in bus.unit if unit.id in needed]
        """The units in the order in which they are to be read; before a single unit also the one before
        it."""
        self._bus = bus
        self._wanted = wanted
        self._span = span
        self._max_readings = min(MAX_READINGS_OF_UNIT, max_readings // max(1, len(needed)))
        self._before: dict[int, _Speeds] = {}

    def read(self, connection: tables.StoreConnection, tail: Tail, unit: int) -> UnitReport | None:
        """Read the next of :attr:`units`: from minutes, and where it started or stopped from readings if they
        are not too many and still stored.
        Return None for a unit that is only needed for the draw of the next one."""
        runs, speeds = _unit_figures(connection, tail, self._bus, unit, self._span, self._max_readings)
        draw = _draw(self._bus, unit, self._before, speeds)
        self._before = {unit: speeds}
        return UnitReport(unit, runs, draw) if unit in self._wanted else None


def _draw(bus: BusSettings, unit: int, before: dict[int, _Speeds], speeds: _Speeds) -> DrawFigures | None:
    """Return the draw as the line shows it: of speeds of one quantity, each on a known scale."""
    seam = bus.seams.get(unit)
    other = None if seam is None else before.get(seam.before)
    if seam is None or other is None or speeds.decimals is None or other.decimals is None:
        return None
    quantities = {each.labels.unit for each in bus.unit if each.id in (unit, seam.before)}
    return draw_figures(other.stretches, speeds.stretches) if len(quantities) == 1 else None


def _unit_figures(
    connection: tables.StoreConnection,
    tail: Tail,
    bus: BusSettings,
    unit: int,
    span: tuple[int, int],
    max_readings: int,
) -> tuple[RunFigures | None, _Speeds]:
    start, end = span
    source = stored_unit(connection, tail, bus.name, unit, start - MINUTE, end + MINUTE)
    if source is None:
        return RunFigures(), _Speeds()
    if bus.follower_speed == "ratio" and was_follower(tables.parameter_steps(connection, source.unit), end):
        return None, _Speeds()
    scales = scale_of(source, SeriesQuery(bus, unit, VALUES["actual"], start, end, 1))
    marks = source.marks(start - MINUTE, end + MINUTE)
    changes = sorted({start, end, *marks.lost, *marks.found, *scales.since})
    minutes = _Minutes(speed_minutes(source, start - MINUTE, end + MINUTE), changes)
    is_readable = has_raw(connection, source.unit, start) and minutes.readings <= max_readings
    counted = minutes.stretches(source, start, end, marks if is_readable else None)
    figures = run_figures(counted, bus.estop_healthy, lambda at, raw: scales.at(at).apply(raw))
    figures.by_minute = bool(minutes.unsteady) and not is_readable
    return figures, _Speeds(_at_speed(counted, scales), scales.at(end).decimals)


class _Minutes:
    """The minutes of a unit, in order of time. Most are steady, and are counted by their averages; the
    :attr:`unsteady` ones, in which it started or stopped, or which ``changes`` or a hole cut, by their
    readings."""

    def __init__(self, minutes: list[SpeedMinute], changes: Sequence[int]) -> None:
        self._minutes = minutes
        # No minute follows the last one, so its last reading counts as long as it does.
        self._ends = [
            *(each.start for each in minutes[1:]),
            *(each.start + 2 * MINUTE for each in minutes[-1:]),
        ]
        fullest = max((each.readings for each in minutes), default=0)
        few = [False, *(each.readings < ENOUGH * fullest for each in minutes), False]
        self._is_steady = [
            each.is_steady
            and until == each.start + MINUTE
            and not any(few[place : place + 3])
            and bisect_left(changes, each.start) == bisect_right(changes, until)
            for place, (each, until) in enumerate(zip(minutes, self._ends, strict=True))
        ]

    @property
    def unsteady(self) -> list[SpeedMinute]:
        return [each for each, is_steady in zip(self._minutes, self._is_steady, strict=True) if not is_steady]

    @property
    def readings(self) -> int:
        """The number of readings of the unsteady minutes."""
        return sum(each.readings for each in self.unsteady)

    def stretches(self, source: StoredUnit, start: int, end: int, marks: Marks | None) -> list[RunStretch]:
        """Return what the unit did between two times, µs. ``marks``: to read the unsteady minutes with; None:
        their averages count as well."""
        found: list[RunStretch] = []
        rows = zip(self._minutes, self._ends, self._is_steady, strict=True)
        by_part = groupby(rows, key=lambda row: (row[2] or marks is None, row[0].start // HOUR))
        for (is_average, _), part in by_part:
            minutes = list(part)
            if is_average or marks is None:
                found += (each.stretch(start, end) for each, _, _ in minutes)
            else:
                first, until = minutes[0][0].start, minutes[-1][1]
                runs = runs_between(source, first - MINUTE, until + MINUTE)
                found += stretches(runs, max(start, first), min(end, until), marks)
        return [each for each in found if each.until > each.at]


def _at_speed(counted: Iterable[RunStretch], scales: Scaling) -> list[SpeedStretch]:
    return [
        SpeedStretch(each.at, each.until, scales.at(each.at).apply(each.actual))
        for each in counted
        if each.is_at_speed
    ]


def was_follower(steps: Iterable[ParameterStep], end: int) -> bool:
    """Return whether a unit followed a master just before a time, µs."""
    modes = [step for step in sorted(steps) if step.number == FOLLOWER_MODE and step.at < end]
    return bool(modes and modes[-1].raw)

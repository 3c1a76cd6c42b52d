"""The report on what units did over a span, from the store."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from app.line.history import tables
from app.line.history.query import (
    SeriesQuery,
    StoredUnit,
    estimate,
    has_raw,
    minutes_of,
    runs_between,
    scale_of,
    stored_unit,
)
from app.line.history.recorder import Tail
from app.line.history.series.figures import (
    DrawFigures,
    RunFigures,
    RunStretch,
    SpeedStretch,
    draw_figures,
    run_figures,
    runs_of_minutes,
    stretches,
)
from app.line.history.series.runs import MINUTE, Run
from app.line.history.series.values import VALUES, ParameterStep, Scaling
from bus.catalogue.parameters import FOLLOWER_MODE
from bus.settings import BusSettings

MAX_READINGS = 1_500_000
"""With more readings a report uses minutes. A bus at 9600 baud has 1.1 million in a shift."""
MAX_READINGS_OF_UNIT = 150_000
"""The readings of one unit that can be read in a second or two."""


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
        """Read the next of :attr:`units`, from minutes if its readings are too many or no longer stored.
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
    by_minute = not has_raw(connection, source.unit, start) or estimate(source, start, end) > max_readings
    marks = source.marks(start - MINUTE, end + MINUTE)
    counted = stretches(_runs(source, start - MINUTE, end + MINUTE, by_minute), start, end, marks)
    figures = run_figures(counted, bus.estop_healthy, lambda at, raw: scales.at(at).apply(raw))
    figures.by_minute = by_minute
    return figures, _Speeds(_at_speed(counted, scales), scales.at(end).decimals)


def _runs(source: StoredUnit, start: int, end: int, by_minute: bool) -> list[Run]:
    return runs_of_minutes(minutes_of(source, start, end)) if by_minute else runs_between(source, start, end)


def _at_speed(counted: Iterable[RunStretch], scales: Scaling) -> list[SpeedStretch]:
    return [
        SpeedStretch(each.at, each.until, scales.at(each.at).apply(each.run.actual))
        for each in counted
        if each.is_at_speed
    ]


def was_follower(steps: Iterable[ParameterStep], end: int) -> bool:
    """Return whether a unit followed a master just before a time, µs."""
    modes = [step for step in sorted(steps) if step.number == FOLLOWER_MODE and step.at < end]
    return bool(modes and modes[-1].raw)

"""Queries of the history: one value over a span in a limited number of points, in the resolution that
fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from app.core.database.connection import snapshot
from app.line.history import tables, unit_history
from app.line.history.series.downsampling import Points, Series, downsample, grid, holes_in, series
from app.line.history.series.figures import STORED_DECIMALS, draw_series
from app.line.history.series.runs import HOUR, MINUTE
from app.line.history.series.values import VALUES, Marks, Scaling, Value, scaling
from app.line.history.tables import BlockKey
from app.line.history.tail import Tail
from bus.settings import BusSettings

MAX_READINGS = 100_000
"""More readings than this are not unpacked for one chart: minutes are used."""
MAX_INTERVALS = 50_000
MARGIN = MINUTE
Resolution = Literal["readings", "minutes", "hours"]


@dataclass(frozen=True, slots=True)
class SeriesQuery:
    """One value of one unit over a span (µs), in at most ``most`` points."""

    bus: BusSettings
    unit: int
    value: Value
    start: int
    end: int
    most: int


@dataclass(slots=True)
class QueryResult:
    """``bucket``: length of the stretch of each point, µs; 0: single readings.
    ``decimals``: of the newest point; None when not known or not fixed."""

    series: Series
    resolution: Resolution = "readings"
    bucket: int = 0
    decimals: int | None = None
    damaged: Sequence[BlockKey] = ()
    """Blocks that could not be read: what they held is missing."""


def stored_queries(query: SeriesQuery) -> list[SeriesQuery]:
    """The stored values that a value is made of: of a draw the actual speeds of the unit before and of the
    unit; of any other value itself."""
    if query.value.kind != "draw":
        return [query]
    units = query.bus.seams[query.unit].before, query.unit
    return [replace(query, unit=unit, value=VALUES["actual"]) for unit in units]


def run_query(connection: tables.StoreConnection, tail: Tail, query: SeriesQuery) -> QueryResult:
    """Read from the store and the tail."""
    if query.value.kind == "draw":
        return _run_draw(connection, tail, query)
    unit = (query.bus.name, query.unit)
    source = unit_history.stored_unit(connection, tail, *unit, query.start, query.end)
    if source is None:
        return QueryResult(Series())
    with snapshot(connection):
        return _run(source, query)


def _run_draw(connection: tables.StoreConnection, tail: Tail, query: SeriesQuery) -> QueryResult:
    """Make a draw of two speeds, each in half of the points, as they may be at different times."""
    half = replace(query, most=max(1, query.most // 2))
    before, section = (run_query(connection, tail, each) for each in stored_queries(half))
    coarser = max(before, section, key=lambda each: each.bucket)
    made = draw_series(before.series, section.series, coarser.bucket)
    damaged = [*before.damaged, *section.damaged]
    return QueryResult(made, coarser.resolution, coarser.bucket, STORED_DECIMALS, damaged)


def _run(source: unit_history.StoredUnit, query: SeriesQuery) -> QueryResult:
    marks = source.marks(query.start - MARGIN, query.end)
    resolution, points = _points(source, query, marks)
    scales = scale_of(source, query)
    decimals = scales.at(query.end).decimals
    return QueryResult(series(points, marks, scales), resolution, points.width, decimals, source.damaged)


def scale_of(source: unit_history.StoredUnit, query: SeriesQuery) -> Scaling:
    """The scales of a value over all time."""
    steps = tables.parameter_steps(source.connection, source.unit)
    ratio = query.bus.follower_speed == "ratio"
    return scaling(query.value, steps, ratio=ratio, estop_healthy=query.bus.estop_healthy)


def _points(source: unit_history.StoredUnit, query: SeriesQuery, marks: Marks) -> tuple[Resolution, Points]:
    value, start, end, most = query.value, query.start, query.end, query.most
    width, _ = grid(start, end, most)
    exact: Points | None = None
    if value.kind == "bit" and tables.count_bits(source.connection, source.unit, start, end) <= MAX_INTERVALS:
        exact = unit_history.bit_points(source, value.bit, start, end, marks)
        if _fits(exact, marks, most):
            return "readings", exact
    is_kept = has_raw(source.connection, source.unit, start)
    if is_kept and unit_history.estimate(source, start, end) <= MAX_READINGS:
        raw = unit_history.readings(source, value, start, end)
        if _fits(raw, marks, most):
            return "readings", raw
        if width < MINUTE or not tables.rolled_up(source.connection, source.unit, start, end):
            return "readings", downsample(raw, start, end, most)
    if exact is not None and width < MINUTE:
        return "readings", downsample(exact, start, end, most)
    tier: tables.RollupTier = "hours" if width >= HOUR else "minutes"
    return tier, downsample(unit_history.rollups(source, tier, value, start, end), start, end, most)


def _fits(points: Points, marks: Marks, most: int) -> bool:
    return len(points.at) + len(holes_in(points, marks)) <= most


def has_raw(connection: tables.StoreConnection, unit: int, start: int) -> bool:
    """Whether every reading of a unit from ``start`` on is still there."""
    given_up = tables.raw_from(connection)
    return start >= given_up or not tables.rolled_up(connection, unit, start, given_up)

"""Queries of the history, from the store and the tail: one value over a span in a limited number of points,
in the resolution that fits; readings, minutes, hours, bits or complete runs of one unit."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, compress, groupby, pairwise
from statistics import median_low
from typing import Any, Literal, TypeVar

from app.core.database.connection import snapshot
from app.line.history import tables
from app.line.history.recorder import Tail
from app.line.history.series.figures import (
    STORED_DECIMALS,
    Points,
    Series,
    SpeedMinute,
    downsample,
    draw_series,
    grid,
    holes_in,
    in_order,
    series,
)
from app.line.history.series.runs import (
    FIELDS,
    HOUR,
    MINUTE,
    PlainRun,
    Rollup,
    Run,
    combine,
    merge,
    minute_rollups,
    replace_rows,
    rollup,
    unpack_columns,
    unpack_integers,
    unpack_rollups,
)
from app.line.history.series.values import (
    VALUES,
    Interval,
    Marks,
    Scaling,
    Value,
    intervals,
    scaling,
    usual_interval,
)
from app.line.history.tables import BlockKey, StoredTier
from bus.settings import BusSettings

MAX_READINGS = 100_000
"""The most readings of a chart; with more it uses minutes."""
MAX_INTERVALS = 50_000
MARGIN = MINUTE
Resolution = Literal["readings", "minutes", "hours"]


@dataclass(frozen=True, slots=True)
class SeriesQuery:
    """The query of one value of one unit over a span (µs), in at most ``most`` points."""

    bus: BusSettings
    unit: int
    value: Value
    start: int
    end: int
    most: int


@dataclass(slots=True)
class QueryResult:
    """The result of a query. ``bucket``: the length of the stretch of each point, µs, 0 for single readings;
    ``decimals``: those of the newest point, None if not known or not fixed."""

    series: Series
    resolution: Resolution = "readings"
    bucket: int = 0
    decimals: int | None = None
    damaged: Sequence[BlockKey] = ()
    """Blocks that could not be read, whose content is missing."""


def stored_queries(query: SeriesQuery) -> list[SeriesQuery]:
    """Return the queries of the stored values that a value is made of: for a draw the actual speeds of the
    unit before and of the unit, for any other value itself."""
    if query.value.kind != "draw":
        return [query]
    units = query.bus.seams[query.unit].before, query.unit
    return [replace(query, unit=unit, value=VALUES["actual"]) for unit in units]


def run_query(connection: tables.StoreConnection, tail: Tail, query: SeriesQuery) -> QueryResult:
    """Run a query on the store and the tail."""
    if query.value.kind == "draw":
        return _run_draw(connection, tail, query)
    unit = (query.bus.name, query.unit)
    source = stored_unit(connection, tail, *unit, query.start, query.end)
    if source is None:
        return QueryResult(Series())
    with snapshot(connection):
        return _run(source, query)


def _run_draw(connection: tables.StoreConnection, tail: Tail, query: SeriesQuery) -> QueryResult:
    """Make a draw of two speeds, each in half of the points, because they may be at different times."""
    half = replace(query, most=max(1, query.most // 2))
    before, section = (run_query(connection, tail, each) for each in stored_queries(half))
    coarser = max(before, section, key=lambda each: each.bucket)
    made = draw_series(before.series, section.series, coarser.bucket)
    damaged = [*before.damaged, *section.damaged]
    return QueryResult(made, coarser.resolution, coarser.bucket, STORED_DECIMALS, damaged)


def _run(source: StoredUnit, query: SeriesQuery) -> QueryResult:
    marks = source.marks(query.start - MARGIN, query.end)
    resolution, points = _points(source, query, marks)
    scales = scale_of(source, query)
    decimals = scales.at(query.end).decimals
    return QueryResult(series(points, marks, scales), resolution, points.width, decimals, source.damaged)


def scale_of(source: StoredUnit, query: SeriesQuery) -> Scaling:
    """Return the scales of a value over all time."""
    return scaling(query.value, tables.parameter_steps(source.connection, source.unit), query.bus)


def _points(source: StoredUnit, query: SeriesQuery, marks: Marks) -> tuple[Resolution, Points]:
    value, start, end, most = query.value, query.start, query.end, query.most
    width, _ = grid(start, end, most)
    exact: Points | None = None
    if value.kind == "bit" and tables.count_bits(source.connection, source.unit, start, end) <= MAX_INTERVALS:
        exact = bit_points(source, value.bit, start, end, marks)
        if _fits(exact, marks, most):
            return "readings", exact
    is_kept = has_raw(source.connection, source.unit, start)
    if is_kept and estimate(source, start, end) <= MAX_READINGS:
        raw = readings(source, value, start, end)
        if _fits(raw, marks, most):
            return "readings", raw
        if width < MINUTE or not tables.rolled_up(source.connection, source.unit, start, end):
            return "readings", downsample(raw, start, end, most)
    if exact is not None and width < MINUTE:
        return "readings", downsample(exact, start, end, most)
    tier: tables.RollupTier = "hours" if width >= HOUR else "minutes"
    return tier, downsample(rollups(source, tier, value, start, end), start, end, most)


def _fits(points: Points, marks: Marks, most: int) -> bool:
    return len(points.at) + len(holes_in(points, marks)) <= most


def has_raw(connection: tables.StoreConnection, unit: int, start: int) -> bool:
    """Return whether all readings of a unit from ``start`` on are still stored."""
    given_up = tables.raw_from(connection)
    return start >= given_up or not tables.rolled_up(connection, unit, start, given_up)


T = TypeVar("T")
Unpacking = Callable[[bytes, int], list[T]]
"""A function that returns the content of a block, from its bytes and its start (µs). Raises ValueError if it
is damaged."""
RawRow = tuple[int, int, int, int]
"""The begin, the end, the number of readings and one raw value of a run."""


@dataclass(frozen=True, slots=True)
class StoredUnit:
    """The sources of one unit's readings: its key, and its runs in the tail over the requested span.

    The tail is read before the store: a minute folded in between is there twice, not never.
    """

    connection: tables.StoreConnection
    unit: int
    tail: Sequence[Run]
    damaged: list[BlockKey] = field(default_factory=list)
    """The blocks that could not be read and were left out."""

    def blocks(
        self, tier: StoredTier, start: int, end: int, unpack: Unpacking[T]
    ) -> Iterator[tuple[int, list[T]]]:
        """Yield start and content of each block that may touch a span (µs), in order of time. A damaged one
        is noted and left out."""
        span = "span" if tier == "raw" else tables.ROW_SPAN[tier]
        longest = HOUR if tier == "raw" else tables.ROW_SPAN[tier]
        within = f"unit = ? AND start > ? AND start < ? AND start + {span} > ?"
        query = f"SELECT start, data FROM {tier} WHERE {within} ORDER BY start"
        rows = self.connection.execute(query, (self.unit, start - longest, end, start))
        return self._intact(tier, rows, unpack)

    def unpacked(self, start: int, end: int, unpack: Unpacking[T]) -> Iterator[tuple[int, list[T]]]:
        """Yield start and content of each minute of readings whose hour is not packed and has no rollups
        yet."""
        query = (
            "SELECT start, data FROM raw"
            " WHERE unit = ? AND start >= ? AND start < ? AND span = 60000000 ORDER BY start"
        )
        rows = self.connection.execute(query, (self.unit, start, end))
        return self._intact("raw", rows, unpack)

    def newest(self, tier: StoredTier, end: int, unpack: Unpacking[T]) -> list[T]:
        """Return the content of the last block that begins before a time, µs; empty if there is none."""
        query = f"SELECT start, data FROM {tier} WHERE unit = ? AND start < ? ORDER BY start DESC LIMIT 1"
        rows = self.connection.execute(query, (self.unit, end))
        return next((content for _, content in self._intact(tier, rows, unpack)), [])

    def marks(self, start: int, end: int) -> Marks:
        """Read when the unit or its port was lost and found within a span, µs."""
        return tables.link_marks(self.connection, {self.unit: (start, end)})[self.unit]

    def _intact(
        self, tier: StoredTier, rows: Iterable[Any], unpack: Unpacking[T]
    ) -> Iterator[tuple[int, list[T]]]:
        for begin, data in rows:
            try:
                content = unpack(data, begin)
            except ValueError:
                self.damaged.append(BlockKey(tier, self.unit, begin))
            else:
                yield begin, content


def stored_unit(
    connection: tables.StoreConnection, tail: Tail, bus: str, number: int, start: int, end: int
) -> StoredUnit | None:
    """Return the sources of a unit over a span, µs; None for a unit without history. Call this before
    the first read of the store: the tail has to be read before it."""
    key = tables.find_unit(connection, bus, number)
    return None if key is None else StoredUnit(connection, key, tail.runs(key, start, end))


def estimate(source: StoredUnit, start: int, end: int) -> int:
    """Return an estimate of the number of points for single readings."""
    rows = source.connection.execute(
        "SELECT start, span, points FROM raw WHERE unit = ? AND start > ? AND start < ?",
        (source.unit, start - HOUR, end),
    )
    stored = sum(
        points * max(0, min(end, begin + span) - max(start, begin)) // span for begin, span, points in rows
    )
    return int(stored) + 2 * len(source.tail)


def readings(source: StoredUnit, value: Value, start: int, end: int) -> Points:
    """Return the readings between two times, µs: of each run the first and, if it lasted, the last one."""
    rows: list[RawRow] = []
    names = ("at", "until", "readings", value.column)
    unpack = partial(unpack_columns, names=names, within=(start - MINUTE, end))
    for _, table in source.blocks("raw", start, end, unpack):
        rows += zip(*table, strict=True)
    rows += [(run.at, run.until, run.readings, getattr(run, value.column)) for run in source.tail]
    is_rising = not source.tail or all(a[0] <= b[0] for a, b in pairwise(rows))
    ordered = rows if is_rising else sorted(set(rows))
    return _points_of_rows(_clip(ordered, start, end), value.bit, usual_interval(rows))


def _clip(rows: Iterable[RawRow], start: int, end: int) -> Iterator[RawRow]:
    for at, until, count, value in rows:
        if until >= start and at < end:
            yield max(at, start), min(until, end), count, value


def _points_of_rows(rows: Iterable[RawRow], bit: int, usual: int) -> Points:
    points = Points(usual=usual)
    for since, until, count, raw in rows:
        value = raw if bit < 0 else raw >> bit & 1
        lasting = until > since
        points.at.append(since)
        points.least.append(value)
        points.weight.append(max(1, count - lasting))
        points.solid.append(lasting)
        if lasting:
            points.at.append(until)
            points.least.append(value)
            points.weight.append(1)
            points.solid.append(False)
    points.greatest = points.least
    points.total = [v * n for v, n in zip(points.least, points.weight, strict=True)]
    return in_order(points)


def rollups(source: StoredUnit, tier: tables.RollupTier, value: Value, start: int, end: int) -> Points:
    """Return the minutes or hours that touch a span, each with its part of the tail."""
    wanted, found = _wanted(value), Points(width=tables.STEP[tier])
    since = start - start % found.width
    unpacked = _unpacked(source, since, end + -end % found.width, found.width)
    newer = {row.start for row in unpacked}
    blocks = source.blocks(tier, since, end, lambda data, _: unpack_integers(data, wanted))
    stored = ((begin, _without(newer, begin, table)) for begin, table in blocks)
    computed = (rows for rows in (unpacked, _tail_rollups(source, found.width)) if rows)
    for begin, (starts, count, least, greatest, total) in chain(
        stored, ((0, _table(rows, wanted)) for rows in computed)
    ):
        at = [begin + each for each in starts]
        within = slice(bisect_left(at, since), bisect_left(at, end))
        found.at += at[within]
        found.least += _bit_of(least[within], value.bit)
        found.greatest += _bit_of(greatest[within], value.bit)
        found.total += total[within]
        found.weight += count[within]
    found.solid = [False] * len(found.at)
    if found.weight:
        found.usual = found.width // max(1, median_low(found.weight))
    return in_order(found)


def minutes_of(source: StoredUnit, start: int, end: int) -> list[Rollup]:
    """Return the minutes of a span, µs, in order of time."""
    rows = chain.from_iterable(content for _, content in source.blocks("minutes", start, end, unpack_rollups))
    since = start - start % MINUTE
    newer = chain(_unpacked(source, since, end, MINUTE), _tail_rollups(source, MINUTE))
    return [row for row in replace_rows(rows, newer) if start <= row.start < end]


def speed_minutes(source: StoredUnit, start: int, end: int) -> list[SpeedMinute]:
    """Return the part of each minute of a span, µs, that shows the speed, in order of time."""
    wanted = [FIELDS[name] for name in SpeedMinute._fields]
    since = start - start % MINUTE
    found: dict[int, SpeedMinute] = {}
    for begin, (starts, *rest) in source.blocks(
        "minutes", start, end, lambda data, _: unpack_integers(data, wanted)
    ):
        at = [begin + each for each in starts]
        found.update(zip(at, map(SpeedMinute, at, *rest), strict=True))
    for row in chain(_unpacked(source, since, end, MINUTE), _tail_rollups(source, MINUTE)):
        found[row.start] = SpeedMinute._make(getattr(row, name) for name in SpeedMinute._fields)
    return [found[at] for at in sorted(found) if since <= at < end]


def _unpacked(source: StoredUnit, since: int, end: int, step: int) -> list[Rollup]:
    """Return minutes or hours, made of the readings of hours that are not packed."""
    unpack = partial(unpack_columns, names=Run._fields)
    rows = [row for _, table in source.unpacked(since, end, unpack) for row in minute_rollups(table)]
    if step == MINUTE:
        return rows
    return [
        combine(list(group), hour) for hour, group in groupby(rows, lambda row: row.start - row.start % step)
    ]


def _without(newer: Container[int], begin: int, table: Sequence[list[int]]) -> list[list[int]]:
    """Return a block of rollups without those that have newer ones."""
    kept = [begin + start not in newer for start in table[0]]
    return [list(compress(column, kept)) for column in table] if not all(kept) else list(table)


def _table(rows: Sequence[Rollup], wanted: Sequence[int]) -> list[list[int]]:
    """Return the wanted columns of rollups as those of a block that starts at 0."""
    table = list(zip(*([*row[:-1], *row.on] for row in rows), strict=True))
    return [list(table[i]) for i in wanted]


def _bit_of(words: list[int], bit: int) -> list[int]:
    """Return one bit of each word; the words themselves if ``bit`` is negative."""
    return words if bit < 0 else [word >> bit & 1 for word in words]


def _wanted(value: Value) -> list[int]:
    if value.bit < 0:
        names = [f"{value.column}_{part}" for part in ("min", "max", "sum")]
    else:
        names = ["word_and", "word_or", f"on_{value.bit}"]
    return [FIELDS[name] for name in ("start", "readings", *names)]


def _tail_rollups(source: StoredUnit, step: int) -> list[Rollup]:
    by_start: dict[int, list[Run]] = {}
    for run in merge((), source.tail):
        by_start.setdefault(run.at - run.at % step, []).append(run)
    return [rollup(runs, start) for start, runs in sorted(by_start.items())]


def bit_points(source: StoredUnit, bit: int, start: int, end: int, marks: Marks) -> Points:
    """Return one bit over a span: points at both ends of each interval in which it stays the same."""
    stored = tables.bits_around(source.connection, [source.unit], start, end)[source.unit]
    recent = [Interval(run.at, run.until, run.word) for run in source.tail]
    touching = (part for part in chain(stored, recent) if part.until >= start and part.at < end)
    usual = usual_of(source, end)
    parts = intervals((part._replace(word=part.word >> bit & 1) for part in touching), marks, usual)
    rows = ((part.at, part.until, 2, part.word) for part in parts)
    return _points_of_rows(_clip(rows, start, end), -1, usual)


def usual_of(source: StoredUnit, end: int) -> int:
    """Return the usual interval between responses before a time, µs, even if its readings are gone."""
    if source.tail:
        return usual_interval(source.tail)
    if runs := source.newest("raw", end, partial(unpack_columns, names=("at", "until", "readings"))):
        return usual_interval(list(zip(*runs, strict=True)))
    minutes = source.newest("minutes", end, lambda data, _: unpack_integers(data, [FIELDS["readings"]]))
    return MINUTE // max(minutes[0]) if minutes else 0


def runs_between(source: StoredUnit, start: int, end: int) -> list[Run]:
    """Return the runs that begin within a span, µs, in order of time."""
    found: list[PlainRun] = []
    unpack = partial(unpack_columns, names=Run._fields, within=(start, end))
    for _, table in source.blocks("raw", start, end, unpack):
        found += zip(*table, strict=True)
    return merge(found, (run for run in source.tail if start <= run.at < end))


def stored_tail(connection: tables.StoreConnection) -> Tail:
    """Read the journal into a tail, as a server does at its start, without changing anything."""
    tail = Tail()
    for rows in tables.read_journal(connection):
        tail.add(rows or ())
    return tail

"""The history of one unit from the store and the tail: readings, minutes, hours, bits or complete runs."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, compress, groupby, pairwise
from statistics import median_low
from typing import Any, TypeVar

from app.line.history import tables
from app.line.history.series import columns
from app.line.history.series.downsampling import Points, in_order
from app.line.history.series.rollup import (
    FIELDS,
    Rollup,
    combine,
    minute_rollups,
    replace_rows,
    rollup,
    unpack_rollups,
)
from app.line.history.series.runs import HOUR, MINUTE, PlainRun, Run, merge, unpack_columns
from app.line.history.series.values import Interval, Marks, Value, intervals, usual_interval
from app.line.history.tables import BlockKey, StoredTier
from app.line.history.tail import Tail

T = TypeVar("T")
Unpacking = Callable[[bytes, int], list[T]]
"""The content of a block of these bytes from this time on (µs). Raises ValueError where it is damaged."""
RawRow = tuple[int, int, int, int]
"""at, until, count and one raw value of a run."""


@dataclass(frozen=True, slots=True)
class StoredUnit:
    """The sources of one unit's readings: its key, and its runs in the tail over the requested span.

    The tail is read before the store: a minute folded in between is there twice, not never.
    """

    connection: tables.StoreConnection
    unit: int
    tail: Sequence[Run]
    damaged: list[BlockKey] = field(default_factory=list)
    """Blocks that could not be read, and were left out."""

    def blocks(
        self, tier: StoredTier, start: int, end: int, unpack: Unpacking[T]
    ) -> Iterator[tuple[int, list[T]]]:
        """Start and content of each block that may touch a span (µs), in order of time. A damaged one is
        noted and left out."""
        span = "span" if tier == "raw" else tables.ROW_SPAN[tier]
        longest = HOUR if tier == "raw" else tables.ROW_SPAN[tier]
        within = f"unit = ? AND start > ? AND start < ? AND start + {span} > ?"
        query = f"SELECT start, data FROM {tier} WHERE {within} ORDER BY start"
        rows = self.connection.execute(query, (self.unit, start - longest, end, start))
        return self._intact(tier, rows, unpack)

    def unpacked(self, start: int, end: int, unpack: Unpacking[T]) -> Iterator[tuple[int, list[T]]]:
        """Yield start and content of each minute of readings whose hour is not packed, and has no rollups
        yet."""
        query = (
            "SELECT start, data FROM raw"
            " WHERE unit = ? AND start >= ? AND start < ? AND span = 60000000 ORDER BY start"
        )
        rows = self.connection.execute(query, (self.unit, start, end))
        return self._intact("raw", rows, unpack)

    def newest(self, tier: StoredTier, end: int, unpack: Unpacking[T]) -> list[T]:
        """The content of the last block that begins before a time, µs; empty where there is none."""
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
    """The sources of a unit over a span, µs; None for one without history. Called before a snapshot."""
    key = tables.find_unit(connection, bus, number)
    return None if key is None else StoredUnit(connection, key, tail.runs(key, start, end))


def estimate(source: StoredUnit, start: int, end: int) -> int:
    """About how many points the readings themselves would be."""
    rows = source.connection.execute(
        "SELECT start, span, points FROM raw WHERE unit = ? AND start > ? AND start < ?",
        (source.unit, start - HOUR, end),
    )
    stored = sum(
        points * max(0, min(end, begin + span) - max(start, begin)) // span for begin, span, points in rows
    )
    return int(stored) + 2 * len(source.tail)


def readings(source: StoredUnit, value: Value, start: int, end: int) -> Points:
    """Every reading between two times, µs: a run as its first and, if it lasted, its last one."""
    rows: list[RawRow] = []
    unpack = partial(unpack_columns, names=("at", "until", "readings", value.column))
    for _, (at, until, count, values) in source.blocks("raw", start, end, unpack):
        first, last = bisect_left(at, start - MINUTE), bisect_left(at, end)
        rows += list(zip(at, until, count, values, strict=True))[first:last]
    rows += [(run.at, run.until, run.readings, getattr(run, value.column)) for run in source.tail]
    is_rising = not source.tail or all(a[0] <= b[0] for a, b in pairwise(rows))
    ordered = rows if is_rising else sorted(set(rows))
    return _points(_clip(ordered, start, end), value.bit, usual_interval(rows))


def _clip(rows: Iterable[RawRow], start: int, end: int) -> Iterator[RawRow]:
    for at, until, count, value in rows:
        if until >= start and at < end:
            yield max(at, start), min(until, end), count, value


def _points(rows: Iterable[RawRow], bit: int, usual: int) -> Points:
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
    """Minutes or hours that touch a span, each with its part of the tail."""
    wanted, found = _wanted(value), Points(width=tables.STEP[tier])
    since = start - start % found.width
    unpacked = _unpacked(source, since, end + -end % found.width, found.width)
    newer = {row.start for row in unpacked}
    blocks = source.blocks(tier, since, end, lambda data, _: columns.unpack(data, wanted))
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
    """The minutes of a span, µs, in order of time."""
    rows = chain.from_iterable(content for _, content in source.blocks("minutes", start, end, unpack_rollups))
    since = start - start % MINUTE
    newer = chain(_unpacked(source, since, end, MINUTE), _tail_rollups(source, MINUTE))
    return [row for row in replace_rows(rows, newer) if start <= row.start < end]


def _unpacked(source: StoredUnit, since: int, end: int, step: int) -> list[Rollup]:
    """Minutes or hours of the readings of hours that are not packed."""
    unpack = partial(unpack_columns, names=Run._fields)
    rows = [row for _, table in source.unpacked(since, end, unpack) for row in minute_rollups(table)]
    if step == MINUTE:
        return rows
    return [
        combine(list(group), hour) for hour, group in groupby(rows, lambda row: row.start - row.start % step)
    ]


def _without(newer: Container[int], begin: int, table: Sequence[list[int]]) -> list[list[int]]:
    """A block of rollups without those of which there are newer ones."""
    kept = [begin + start not in newer for start in table[0]]
    return [list(compress(column, kept)) for column in table] if not all(kept) else list(table)


def _table(rows: Sequence[Rollup], wanted: Sequence[int]) -> list[list[int]]:
    """The wanted columns of rollups, as a block from time 0 on."""
    table = list(zip(*([*row[:-1], *row.on] for row in rows), strict=True))
    return [list(table[i]) for i in wanted]


def _bit_of(words: list[int], bit: int) -> list[int]:
    """Return one bit of each word; the words themselves where ``bit`` is below 0."""
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
    """One bit over a span, exactly: the intervals in which it stays, as points at both their ends."""
    stored = tables.bits_around(source.connection, [source.unit], start, end)[source.unit]
    recent = [Interval(run.at, run.until, run.word) for run in source.tail]
    touching = (part for part in chain(stored, recent) if part.until >= start and part.at < end)
    usual = usual_of(source, end)
    parts = intervals((part._replace(word=part.word >> bit & 1) for part in touching), marks, usual)
    rows = ((part.at, part.until, 2, part.word) for part in parts)
    return _points(_clip(rows, start, end), -1, usual)


def usual_of(source: StoredUnit, end: int) -> int:
    """How often the unit responded before a time, µs, whether or not its readings are still kept."""
    if source.tail:
        return usual_interval(source.tail)
    if runs := source.newest("raw", end, partial(unpack_columns, names=("at", "until", "readings"))):
        return usual_interval(list(zip(*runs, strict=True)))
    minutes = source.newest("minutes", end, lambda data, _: columns.unpack(data, [FIELDS["readings"]]))
    return MINUTE // max(minutes[0]) if minutes else 0


def runs_between(source: StoredUnit, start: int, end: int) -> list[Run]:
    """Return the runs that begin within a span, µs, in order of time."""
    found: list[PlainRun] = []
    for _, table in source.blocks("raw", start, end, partial(unpack_columns, names=Run._fields)):
        first, last = bisect_left(table[0], start), bisect_left(table[0], end)
        found += zip(*(column[first:last] for column in table), strict=True)
    return merge(found, (run for run in source.tail if start <= run.at < end))

"""The report of the units of a bus over a span: for hours that are over from figures that are computed once
and stored, for the rest from minutes, and from readings if a unit started or stopped."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, groupby, islice
from operator import gt
from zlib import crc32

import msgspec

from app.line.history import tables
from app.line.history.query import StoredUnit, has_raw, speed_minutes, stored_unit
from app.line.history.recorder import Tail
from app.line.history.series.figures import (
    DrawFigures,
    PassedWeb,
    RunFigures,
    RunStretch,
    SpeedMinute,
    SpeedStretch,
    draw_figures,
    joined,
    passed_web,
    run_figures,
    stretches,
)
from app.line.history.series.runs import HOUR, MINUTE, Run, merge, unpack_columns
from app.line.history.series.values import (
    VALUES,
    LinearScale,
    Marks,
    Scaling,
    scaling,
    usual_interval,
    was_follower,
)
from bus.settings import BusSettings

MAX_REPORT_READINGS = 200_000
"""The readings in unsteady minutes above which a report uses averages for them."""
MAX_READINGS_OF_UNIT = 40_000
"""Two hours of readings at 9600 baud on a bus of eight, and so some fifty starts and stops."""
_SAMPLE = 500
"""Readings that show the usual interval between them."""
ENOUGH = 0.92
"""A minute with a smaller part of the readings of the fullest one may contain half of a hole."""


@dataclass(frozen=True, slots=True)
class UnitReport:
    """The figures of a unit, and its draw to the unit before; None without one, or if the two were never at
    speed at the same time."""

    unit: int
    runs: RunFigures | None
    """None for a follower whose speeds are ratios, which do not show whether it runs."""
    draw: DrawFigures | None = None


class PartFigures(msgspec.Struct, array_like=True):
    """The figures of a unit over a part of a span, and the web that passed it and the unit before."""

    runs: RunFigures
    web: PassedWeb | None = None


_DECODER = msgspec.json.Decoder(PartFigures)
_SEAL_BYTES = 4
_Part = tuple[int, tuple[int, int]]
"""A unit and a part of the span, µs."""
_FORMAT = 1
"""Increased with every change of the meaning of figures, so that stored ones are computed anew."""


def _seal(data: bytes, basis: int) -> bytes:
    """Return a checksum of packed figures and of their basis (:func:`basis_of`)."""
    return crc32(data, basis).to_bytes(_SEAL_BYTES)


def is_sealed(packed: bytes, basis: int) -> bool:
    """Return whether packed figures are as they were stored, and from this basis."""
    return _seal(packed[_SEAL_BYTES:], basis) == packed[:_SEAL_BYTES]


def basis_of(connection: tables.StoreConnection, bus: BusSettings, unit: int) -> int:
    """Return a checksum of everything besides readings that determines a unit's figures: settings and
    scales."""
    units = units_of(bus, unit)
    keys = [tables.find_unit(connection, bus.name, each) for each in units]
    steps = [tables.parameter_steps(connection, key) for key in keys if key is not None]
    return crc32(repr((_FORMAT, units, bus.estop_healthy, bus.follower_speed, steps)).encode())


def unit_before(bus: BusSettings, unit: int) -> int | None:
    """Return the unit before one to which it has a draw, as the line shows it: of speeds of one quantity."""
    before = bus.seams[unit].before if unit in bus.seams else None
    quantities = {each.labels.unit for each in bus.unit if each.id in (before, unit)}
    return before if len(quantities) == 1 else None


def units_of(bus: BusSettings, unit: int) -> list[int]:
    """Return the units whose readings determine a unit's figures: the one before it, and itself."""
    return [each for each in (unit_before(bus, unit), unit) if each is not None]


def work_out(connection: tables.StoreConnection, bus: BusSettings, unit: int, hour: int) -> None:
    """Store the figures of a unit and a packed hour. Late readings of the hour or next to it delete them, in
    the transaction that stores the readings."""
    key = tables.find_unit(connection, bus.name, unit)
    assert key is not None
    span = hour, hour + HOUR
    data = msgspec.json.encode(BusReport(bus, unit, span).figures(connection, Tail(), unit, span))
    tables.write_figures(connection, key, hour, _seal(data, basis_of(connection, bus, unit)) + data)


class BusReport:
    """The figures of the units of a bus, or ``only`` one of them, over a span, µs. Each unit is read on its
    own, so that no read takes long."""

    def __init__(
        self,
        bus: BusSettings,
        only: int | None,
        span: tuple[int, int],
        max_readings: int = MAX_REPORT_READINGS,
    ) -> None:
        self.units = [unit.id for unit in bus.unit if only in (None, unit.id)]
        """The units in the order in which they are to be read."""
        self._bus = bus
        self._span = span
        self._max_readings = min(MAX_READINGS_OF_UNIT, max_readings // max(1, len(self.units)))
        self._left: float = math.inf
        """The readings that may still be read of a unit."""
        self._speeds: dict[_Part, list[SpeedStretch]] = {}
        self._former: dict[_Part, list[SpeedStretch]] = {}
        """The speeds in each part that was read of the unit, and of the unit that was read before it."""

    def read(self, connection: tables.StoreConnection, tail: Tail, unit: int) -> UnitReport:
        """Read the next of :attr:`units`: from stored figures of hours, else from minutes, and if it started
        or stopped from readings, unless these are too many or no longer stored."""
        self._former, self._speeds, self._left = self._speeds, {}, self._max_readings
        scale = self._scale(connection, unit)
        if scale is None:
            return UnitReport(unit, None)
        parts = list(self._parts(connection, tail, unit))
        before = unit_before(self._bus, unit)
        other = None if before is None else self._scale(connection, before)
        is_drawn = other is not None and None not in (scale.decimals, other.decimals)
        draw = draw_figures(part.web for part in parts) if is_drawn else None
        return UnitReport(unit, joined(part.runs for part in parts), draw)

    def _scale(self, connection: tables.StoreConnection, unit: int) -> LinearScale | None:
        """Return the scale of the speed of a unit at the end; None if it is a ratio to a master by then."""
        key, end = tables.find_unit(connection, self._bus.name, unit), self._span[1]
        steps = [] if key is None else tables.parameter_steps(connection, key)
        is_ratio = self._bus.follower_speed == "ratio" and was_follower(steps, end)
        return None if is_ratio else scaling(VALUES["actual"], steps, self._bus).at(end)

    def _parts(self, connection: tables.StoreConnection, tail: Tail, unit: int) -> Iterator[PartFigures]:
        """Yield the figures of each part of the span, in order of time."""
        at, end = self._span
        hours = at + -at % HOUR, end - end % HOUR
        basis = basis_of(connection, self._bus, unit)
        keys = (tables.find_unit(connection, self._bus.name, each) for each in units_of(self._bus, unit))
        # Before the figures are read: what is in the tail then and not in its block is not in them.
        late = tail.hours_near([key for key in keys if key is not None])
        for hour, packed in tables.figures_between(connection, self._bus.name, unit, *hours):
            if hour in late or not is_sealed(packed, basis):
                continue
            if at < hour:
                yield self.figures(connection, tail, unit, (at, hour))
            yield _DECODER.decode(packed[_SEAL_BYTES:])
            at = hour + HOUR
        if at < end:
            yield self.figures(connection, tail, unit, (at, end))

    def figures(
        self, connection: tables.StoreConnection, tail: Tail, unit: int, span: tuple[int, int]
    ) -> PartFigures:
        """Compute the figures of a part of the span."""
        runs, speeds = self._read(connection, tail, unit, span)
        self._speeds[unit, span] = speeds
        before = unit_before(self._bus, unit)
        if before is None:
            return PartFigures(runs)
        former = self._former.get((before, span))
        if former is None:
            _, former = self._read(connection, tail, before, span)
        return PartFigures(runs, passed_web(former, speeds))

    def _read(
        self, connection: tables.StoreConnection, tail: Tail, unit: int, span: tuple[int, int]
    ) -> tuple[RunFigures, list[SpeedStretch]]:
        """Read the figures of a unit, and its speeds while it was at speed."""
        start, end = span
        source = stored_unit(connection, tail, self._bus.name, unit, start - MINUTE, end + MINUTE)
        if source is None:
            return RunFigures(), []
        scales = scaling(VALUES["actual"], tables.parameter_steps(connection, source.unit), self._bus)
        marks = source.marks(start - MINUTE, end + MINUTE)
        edges = (edge for edge in span if edge % MINUTE)
        changes = sorted({*edges, *marks.lost, *marks.found, *scales.since})
        minutes = _Minutes(speed_minutes(source, start - MINUTE, end + MINUTE), changes)
        is_readable = has_raw(connection, source.unit, start) and minutes.readings <= self._left
        if is_readable:
            self._left -= minutes.readings
        counted = minutes.stretches(source, start, end, marks if is_readable else None)
        figures = run_figures(counted, self._bus.estop_healthy, scales)
        figures.by_minute = bool(minutes.unsteady) and not is_readable
        return figures, _at_speed(counted, scales)


class _Minutes:
    """The minutes of a unit, in order of time. Most are steady and counted by their averages; the
    :attr:`unsteady` ones, in which it started or stopped, or which ``changes`` or a hole cut, by their
    readings."""

    def __init__(self, minutes: list[SpeedMinute], changes: Sequence[int]) -> None:
        self._minutes = minutes
        self._changes = changes
        # No minute follows the last one, so its last reading counts as long as it does.
        self._ends = [
            *(each.start for each in minutes[1:]),
            *(each.start + 2 * MINUTE for each in minutes[-1:]),
        ]
        fullest = max((each.readings for each in minutes), default=0)
        few = [False, *(each.readings < ENOUGH * fullest for each in minutes), False]
        cut = {(change - before) // MINUTE for change in changes for before in (0, 1)}
        self._is_steady = [
            each.is_steady
            and until == each.start + MINUTE
            and each.start // MINUTE not in cut
            and not any(near)
            for each, until, *near in zip(minutes, self._ends, few[:-2], few[1:-1], few[2:], strict=True)
        ]

    @property
    def unsteady(self) -> list[SpeedMinute]:
        return [each for each, is_steady in zip(self._minutes, self._is_steady, strict=True) if not is_steady]

    @property
    def readings(self) -> int:
        """The number of readings of the unsteady minutes."""
        return sum(each.readings for each in self.unsteady)

    def stretches(self, source: StoredUnit, start: int, end: int, marks: Marks | None) -> list[RunStretch]:
        """Return the stretches in which the unit ran or stood, in order, between two times in µs since 1970.
        ``marks``: when the unit was lost and found; None counts unsteady minutes by their averages."""
        found: list[RunStretch] = []
        rows = (
            row
            for row in zip(self._minutes, self._ends, self._is_steady, strict=True)
            if row[0].start < end and row[1] > start
        )
        by_part = groupby(rows, key=lambda row: (row[2] or marks is None, row[0].start // HOUR))
        readings = _Readings(source, (start - 2 * MINUTE, end + 2 * MINUTE))
        for (is_average, _), part in by_part:
            minutes = list(part)
            if is_average or marks is None:
                found += (each.stretch() for each, _, _ in minutes)
            else:
                first, until = minutes[0][0].start, minutes[-1][1]
                table, usual = readings.around(first, until)
                found += stretches(table, (first, until), marks, usual, self._changes)
        return [
            each
            if start <= each.at and each.until <= end
            else each._replace(at=max(start, each.at), until=min(end, each.until))
            for each in found
            if each.at < end and each.until > start
        ]


class _Readings:
    """The readings of a unit within a span, µs, read part by part in order of time. The blocks of the last
    part stay unpacked, because an hour has many parts."""

    def __init__(self, source: StoredUnit, span: tuple[int, int]) -> None:
        self._source = source
        self._span = span
        self._blocks: dict[tuple[int, bytes], list[list[int]]] = {}
        self._usual = 0

    def around(self, start: int, end: int) -> tuple[Sequence[Sequence[int]], int]:
        """Return the columns of the runs that begin within a span, µs, with the run before and the one after
        it, and the usual interval between responses."""
        first, until = start - MINUTE, end + MINUTE
        former, self._blocks = self._blocks, {}

        def unpack(data: bytes, begin: int) -> list[list[int]]:
            found = former.get((begin, data)) or unpack_columns(data, begin, Run._fields, self._span)
            self._blocks[begin, data] = found
            within = slice(*(bisect_left(found[0], edge) for edge in (first, until)))
            return [column[within] for column in found]

        tables = [table for _, table in self._source.blocks("raw", first, until, unpack)]
        tail = [run for run in self._source.tail if first <= run.at < until]
        table: Sequence[Sequence[int]] = [
            list(chain.from_iterable(parts)) for parts in zip(*tables, strict=True)
        ]
        if tail or (table and not all(map(gt, table[0][1:], table[1]))):
            table = list(zip(*merge(zip(*table, strict=True), tail), strict=True))
        if not table:
            return [()] * len(Run._fields), 0
        if tail or self._blocks.keys() != former.keys():
            self._usual = usual_interval(list(islice(zip(*table[:3], strict=True), _SAMPLE)))
        wanted = slice(max(0, bisect_left(table[0], start) - 1), bisect_left(table[0], end) + 1)
        return [column[wanted] for column in table], self._usual


def _at_speed(counted: Sequence[RunStretch], scales: Scaling) -> list[SpeedStretch]:
    at_speed = [each for each in counted if each.is_at_speed]
    return [
        SpeedStretch(each.at, each.until, scale.apply(each.actual))
        for i, j, scale in scales.stretches([each.at for each in at_speed])
        for each in at_speed[i:j]
    ]

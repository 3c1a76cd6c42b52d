"""The rows of an export: any span, a piece at a time, so that a year takes no more memory than a day.

One row for each instant at which a unit responded; a value of another unit stays empty there.
Equal consecutive readings are two rows, the first and the last. A hole is a separate row
with a note and no values.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Literal, NamedTuple

from app.core.database.connection import snapshot
from app.core.messages import Language
from app.line.history import tables, unit_history
from app.line.history.query import Resolution, SeriesQuery, scale_of
from app.line.history.series import values
from app.line.history.series.runs import DAY, HOUR, MINUTE, SECOND, Run, micros
from app.line.history.series.values import LinearScale, holes, long_gap, usual_interval
from app.line.history.service import History
from app.line.history.tables import BlockKey
from app.line.history.tail import Tail
from bus.instants import unix_now

PIECE: dict[Resolution, int] = {"readings": HOUR, "minutes": 7 * DAY, "hours": 90 * DAY}
"""The span that is read at a time, µs."""


class Cell(NamedTuple):
    """One value, and with how many decimals it is written (None: as many as it has)."""

    value: float
    decimals: int | None


class ExportRow(NamedTuple):
    """An instant (µs), a cell for each column (None: no reading then), a note. ``ends``: the columns whose
    unit has no readings from here on."""

    at: int
    cells: tuple[Cell | None, ...]
    note: str = ""
    ends: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Table:
    """The columns of an export, and how fine it is. ``carries``: a value that a unit reported steadily from
    before the start has a row at the start, where the unit need not have responded."""

    queries: Sequence[SeriesQuery]
    fineness: Resolution
    time_zone: str
    carries: bool = False

    @property
    def columns(self) -> list[str]:
        """A name for each column: what, then in what it is measured."""
        parts = ("",) if self.fineness == "readings" else (" min", " max", " avg")
        return [_column(query, part) for query in self.queries for part in parts]

    def named(self, language: Language) -> list[str]:
        """Return a name for each column for people: the unit by its name, the value as it is wired, its
        measure."""
        rollup = (language.t("minimum"), language.t("maximum"), language.t("average"))
        parts = [""] if self.fineness == "readings" else [f" {word}" for word in rollup]
        names = [_name(query, language) for query in self.queries]
        places = [f" ({query.bus.name}/{query.unit})" for query in self.queries]
        return [
            f"{name}{place if names.count(name) > 1 else ''}{part}{_measure(query)}"
            for query, name, place in zip(self.queries, names, places, strict=True)
            for part in parts
        ]


def _name(query: SeriesQuery, language: Language) -> str:
    unit = values.unit_settings(query.bus, query.unit)
    return f"{unit.name} {values.label(unit, query.value) or values.text(query.value, language.t)}"


def _measure(query: SeriesQuery) -> str:
    measure = values.measure(values.unit_settings(query.bus, query.unit), query.value)
    return f" [{measure}]" if measure else ""


def _column(query: SeriesQuery, part: str) -> str:
    return f"{query.bus.name}/{query.unit} {query.value.name}{part}{_measure(query)}"


async def pieces(history: History, table: Table) -> AsyncIterator[list[ExportRow]]:
    """Yield all rows in order of time, piece by piece; each piece is its own short read of the store."""
    start, end, step = table.queries[0].start, table.queries[0].end, PIECE[table.fineness]
    begun, ended = await history.read(_extent)
    since, end = max(start, begun), min(end, ended)
    last_until: dict[tuple[str, int], int] = {}
    while since < end:
        until = min(end, since - since % step + step)
        part = [replace(q, start=since, end=until) for q in table.queries]
        damaged: list[BlockKey] = []
        read = partial(_rows, table=table, part=part, last_until=last_until, damaged=damaged)
        yield await history.read(read)
        history.report(damaged)
        since = until


def _extent(connection: tables.StoreConnection, tail: Tail) -> tuple[int, int]:
    """The span of all that can be kept, µs: what the tail holds is not in the store yet, and may
    become older or newer than all that is, until the export ends."""
    now = micros(unix_now())
    spans = [span for span in (tail.extent(), tables.extent(connection), (now - DAY, now)) if span]
    return min(first for first, _ in spans), max(last for _, last in spans) + DAY


def _rows(
    connection: tables.StoreConnection,
    tail: Tail,
    table: Table,
    part: Sequence[SeriesQuery],
    last_until: dict[tuple[str, int], int],
    damaged: list[BlockKey],
) -> list[ExportRow]:
    rows: list[ExportRow] = []
    numbered = list(enumerate(part))
    by_unit = sorted(numbered, key=lambda item: (item[1].bus.name, item[1].unit))
    sources = [
        (unit_history.stored_unit(connection, tail, *unit, part[0].start, part[0].end), list(group))
        for unit, group in groupby(by_unit, key=lambda item: (item[1].bus.name, item[1].unit))
    ]
    with snapshot(connection):
        for source, wanted in sources:
            if source is None:
                continue
            if table.fineness == "readings":
                rows += _reading_rows(source, wanted, len(part), last_until, table.carries)
            else:
                rows += _rollup_rows(source, wanted, 3 * len(part), table.fineness)
            damaged += source.damaged
    rows.sort(key=lambda row: row.at)
    return rows if table.fineness == "readings" else _together(rows)


def _reading_rows(
    source: unit_history.StoredUnit,
    wanted: Sequence[tuple[int, SeriesQuery]],
    width: int,
    last_until: dict[tuple[str, int], int],
    carries: bool,
) -> Iterator[ExportRow]:
    first = wanted[0][1]
    unit = (first.bus.name, first.unit)
    # A run is within a minute: one that began before the first piece may go on in it, and before no other.
    found = unit_history.runs_between(source, first.start - MINUTE, first.end)
    runs = [run for run in found if run.until >= first.start]
    places, nothing = tuple(place for place, _ in wanted), (None,) * width
    if not runs:
        if carries:
            yield ExportRow(first.start, nothing, ends=places)
        return
    holes = _holes(source, last_until.get(unit), runs)
    scales = {place: scale_of(source, query) for place, query in wanted}
    for position, run in enumerate(runs):
        if position in holes:
            note = f"no readings of {unit[0]}/{unit[1]}"
            yield ExportRow(holes[position], nothing, note, places)
        cells: list[Cell | None] = [None] * width
        for place, query in wanted:
            cells[place] = _cell(query, run, scales[place].at(run.at))
        if carries or run.at >= first.start:
            yield ExportRow(max(run.at, first.start), tuple(cells))
        if run.until > run.at:
            # For people the rows end with the span.
            yield ExportRow(min(run.until, first.end - 1) if carries else run.until, tuple(cells))
    last_until[unit] = runs[-1].until
    if carries and min(first.end, micros(unix_now())) - runs[-1].until > long_gap(usual_interval(runs)):
        # It has not come back: nothing is known of it until it does.
        yield ExportRow(runs[-1].until + 1, nothing, ends=places)


def _holes(source: unit_history.StoredUnit, before: int | None, runs: Sequence[Run]) -> dict[int, int]:
    """Before which runs there is a hole, and from when."""
    ends = ([] if before is None else [before, before]) + [t for run in runs for t in (run.at, run.until)]
    marks = source.marks(ends[0], ends[-1])
    found = holes(ends, marks, usual_interval(runs))
    offset = 0 if before is None else 1
    return {(i + 1) // 2 - offset: ends[i] + 1 for i in found if i % 2}


def _cell(query: SeriesQuery, run: Run, scale: LinearScale) -> Cell:
    raw: int = getattr(run, query.value.column)
    if query.value.bit >= 0:
        raw = raw >> query.value.bit & 1
    return Cell(scale.apply(raw), scale.decimals)


def _rollup_rows(
    source: unit_history.StoredUnit,
    wanted: Sequence[tuple[int, SeriesQuery]],
    width: int,
    fineness: Literal["minutes", "hours"],
) -> Iterator[ExportRow]:
    for place, query in wanted:
        points = unit_history.rollups(source, fineness, query.value, query.start, query.end)
        scales = scale_of(source, query)
        columns = (points.at, points.least, points.greatest, points.total, points.weight)
        for at, least, greatest, total, weight in zip(*columns, strict=True):
            scale = scales.at(at)
            low, high = sorted((scale.apply(least), scale.apply(greatest)))
            cells: list[Cell | None] = [None] * width
            cells[3 * place] = Cell(low, scale.decimals)
            cells[3 * place + 1] = Cell(high, scale.decimals)
            cells[3 * place + 2] = Cell(round(scale.apply(total / weight), 6), None)
            yield ExportRow(at, tuple(cells))


def _together(rows: Sequence[ExportRow]) -> list[ExportRow]:
    """Rows of the same instant as one."""
    result: list[ExportRow] = []
    for at, group in groupby(rows, key=lambda row: row.at):
        cells = [
            next((cell for cell in column if cell is not None), None)
            for column in zip(*(row.cells for row in group), strict=True)
        ]
        result.append(ExportRow(at, tuple(cells)))
    return result


STEPS = (SECOND, 5 * SECOND, 15 * SECOND, MINUTE)
MAX_ROWS = 100_000
"""More of them, and the step is a longer one; the longest takes any number."""


def step_of(start: int, end: int) -> int:
    """The distance of two rows over a span, µs."""
    return next((step for step in STEPS if (end - start) / step <= MAX_ROWS), STEPS[-1])


class Together:
    """Brings rows of single readings onto a common time, piece by piece: each value holds from its reading
    until the next one, or until the hole after it, however long it is steady."""

    def __init__(self, width: int, step: int) -> None:
        self._step = step
        self._cells: list[Cell | None] = [None] * width
        self._next: int | None = None

    def rows(self, rows: Iterable[ExportRow]) -> Iterator[ExportRow]:
        """The rows at each step up to the last of these."""
        for row in rows:
            yield from self._until(row.at)
            if self._next is None:
                self._next = -(-row.at // self._step) * self._step
            self._take(row)

    def end(self, end: int) -> Iterator[ExportRow]:
        """The row that is left after the last piece, where it is before the end."""
        if self._next is not None:
            yield from self._until(min(end, self._next + 1))

    def _take(self, row: ExportRow) -> None:
        for place, cell in enumerate(row.cells):
            if cell is not None:
                self._cells[place] = cell
        for place in row.ends:
            self._cells[place] = None

    def _until(self, at: int) -> Iterator[ExportRow]:
        while self._next is not None and self._next < at:
            cells = tuple(self._cells)
            if any(cell is not None for cell in cells):
                yield ExportRow(self._next, cells)
                self._next += self._step
            else:
                # Nothing is known until the next reading.
                self._next = -(-at // self._step) * self._step
                return

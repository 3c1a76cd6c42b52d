"""Exports as downloads: CSV (RFC 4180), or Parquet if that is installed; any span, a piece at a time, so that
a year takes no more memory than a day.

An export has a row for each instant at which a unit responded; values of other units are empty there. Equal
consecutive readings are two rows, the first and the last. A hole is a row with a note and no values.
"""

from __future__ import annotations

import asyncio
import importlib.util
import io
from collections.abc import AsyncIterator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, tzinfo
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, Any, Literal, NamedTuple
from zoneinfo import ZoneInfo

import structlog
from starlette.responses import StreamingResponse

from app.core.database.connection import snapshot
from app.core.messages import Language
from app.core.web.csv_file import FOR_PROGRAMS, Column, CsvForm, Number
from app.core.web.csv_file import Cell as CsvCell
from app.core.web.shape import attachment
from app.errors import Problem
from app.line.history import tables
from app.line.history.query import (
    Resolution,
    SeriesQuery,
    StoredUnit,
    has_raw,
    rollups,
    runs_between,
    scale_of,
    stored_queries,
    stored_unit,
)
from app.line.history.recorder import Tail
from app.line.history.series import values
from app.line.history.series.figures import STORED_DECIMALS, draw_percent
from app.line.history.series.runs import DAY, HOUR, MINUTE, SECOND, Run, micros
from app.line.history.series.values import LinearScale, holes, long_gap, usual_interval
from app.line.history.service import History
from app.line.history.tables import BlockKey
from bus.instants import unix_now
from bus.messages import Message, term

if TYPE_CHECKING:
    import pyarrow


Format = Literal["csv", "parquet"]
ExportResolution = Literal["auto", Resolution]
Layout = Literal["readings", "table"]
"""The rows of a file: one for each reading, or one for each step of time with all values filled in."""


async def export_response(
    history: History,
    queries: Sequence[SeriesQuery],
    file: Format,
    resolution: ExportResolution,
    form: CsvForm = FOR_PROGRAMS,
    layout: Layout = "readings",
) -> StreamingResponse:
    """Stream an export, so that a year takes no more memory than a day. ``form`` and ``layout`` are those of
    CSV. A draw has its column in a table; single readings have the two speeds that it is made of. Raise
    StoreError or Problem before it begins."""
    if file == "parquet" and not await _parquet_is_usable():
        raise Problem(501, "no_parquet", Message("no_parquet"))
    shown = _once(queries)
    queries = _once(stored for query in queries for stored in stored_queries(query))
    fineness = await _fineness(history, queries, resolution)
    table = Table(queries, fineness, history.time_zone, carries=layout == "table", shown=shown)
    name = f"lineside-{_stamp(queries[0].start, table)}-{_stamp(queries[0].end, table)}.{file}"
    headers, rows = attachment(name), pieces(history, table)
    if file == "csv":
        text = (stream_csv if layout == "readings" else stream_table)(table, rows, form)
        return StreamingResponse(text, 200, headers, "text/csv; charset=utf-8")
    media = "application/vnd.apache.parquet"
    return StreamingResponse(_stream_parquet(table, rows), 200, headers, media)


def _once(queries: Iterable[SeriesQuery]) -> list[SeriesQuery]:
    return list({(each.bus.name, each.unit, each.value.name): each for each in queries}.values())


def _stamp(at: int, table: Table) -> str:
    return datetime.fromtimestamp(at / SECOND, ZoneInfo(table.time_zone)).strftime("%Y%m%dT%H%M%S")


async def _fineness(
    history: History, queries: Sequence[SeriesQuery], resolution: ExportResolution
) -> Resolution:
    if resolution != "auto":
        return resolution

    def all_raw(connection: tables.StoreConnection, _tail: Tail) -> bool:
        keys = [tables.find_unit(connection, q.bus.name, q.unit) for q in queries]
        return all(has_raw(connection, key, queries[0].start) for key in keys if key is not None)

    return "readings" if await history.read(all_raw) else "minutes"


async def stream_csv(
    table: Table, pieces: AsyncIterator[list[ExportRow]], form: CsvForm
) -> AsyncIterator[str]:
    """Yield text, piece by piece: one row for each reading, by the clock of the site."""
    site = ZoneInfo(table.time_zone)
    texts = table.columns if form.language is None else table.named(form.language)
    values = map(Column, table.columns, texts)
    columns = [Column(f"time [{site}]", term("Time"), is_time=True), *values, Column("note", term("Note"))]
    yield form.head(columns)
    async for rows in pieces:
        yield await asyncio.to_thread(form.rows, columns, ([*_cells(row, site), row.note] for row in rows))


async def stream_table(
    table: Table, pieces: AsyncIterator[list[ExportRow]], form: CsvForm
) -> AsyncIterator[str]:
    """Yield text for people, piece by piece: one row a time with every value, under the name of its unit."""
    assert form.language is not None
    site = ZoneInfo(table.time_zone)
    start, end = table.queries[0].start, table.queries[0].end
    together = Together(len(table.columns), step_of(start, end)) if table.fineness == "readings" else None
    values = (Column(name, name) for name in table.named(form.language))
    columns = [Column("time", term("Time"), is_time=True), *values]
    yield form.head(columns)

    def text(rows: Iterable[ExportRow]) -> str:
        return form.rows(columns, (_cells(table.as_shown(row), site) for row in rows))

    async for rows in pieces:
        yield await asyncio.to_thread(text, rows if together is None else together.rows(rows))
    if together is not None:
        yield text(together.end(end))


def _cells(row: ExportRow, site: tzinfo) -> list[CsvCell]:
    values = (None if cell is None else _number(cell.value, cell.decimals) for cell in row.cells)
    return [datetime.fromtimestamp(row.at / SECOND, site), *values]


def _number(value: float, decimals: int | None) -> Number:
    return Number(repr(value) if decimals is None else f"{value:.{decimals}f}")


log = structlog.get_logger()
GROUP_ROWS = 20_000
"""Rows in memory before they are written as one row group."""


def has_parquet() -> bool:
    """Return whether pyarrow, an extra, is installed."""
    return importlib.util.find_spec("pyarrow") is not None


async def _parquet_is_usable() -> bool:
    """Return whether pyarrow can also be imported, with everything that it needs."""
    return has_parquet() and await asyncio.to_thread(_can_import)


def _can_import() -> bool:
    try:
        importlib.import_module("pyarrow.parquet")
    except Exception as error:  # a library that does not fit raises anything
        log.warning("pyarrow cannot be used", error=repr(error))
        return False
    return True


async def _stream_parquet(table: Table, pieces: AsyncIterator[list[ExportRow]]) -> AsyncIterator[bytes]:
    """Yield the bytes of a Parquet file, one row group after the other."""
    import pyarrow
    from pyarrow import parquet

    schema = _schema(pyarrow, table)
    sink = io.BytesIO()
    with parquet.ParquetWriter(sink, schema, compression="zstd") as writer:
        waiting: list[ExportRow] = []
        async for rows in pieces:
            waiting += rows
            if len(waiting) >= GROUP_ROWS:
                await asyncio.to_thread(_write, pyarrow, writer, waiting)
                waiting = []
                yield _taken(sink)
        if waiting:
            await asyncio.to_thread(_write, pyarrow, writer, waiting)
    yield _taken(sink)


def _schema(arrow: Any, table: Table) -> pyarrow.Schema:
    fields = [("time", arrow.timestamp("us", tz=table.time_zone))]
    fields += [(name, arrow.float64()) for name in table.columns]
    fields.append(("note", arrow.string()))
    return arrow.schema(fields, metadata={"time_zone": table.time_zone, "resolution": table.fineness})


def _write(arrow: Any, writer: Any, rows: Sequence[ExportRow]) -> None:
    cells = zip(*(row.cells for row in rows), strict=True)
    columns: list[Sequence[Any]] = [
        [row.at for row in rows],
        *([None if cell is None else cell.value for cell in column] for column in cells),
        [row.note or None for row in rows],
    ]
    arrays = [arrow.array(column, field.type) for column, field in zip(columns, writer.schema, strict=True)]
    writer.write_table(arrow.Table.from_arrays(arrays, schema=writer.schema))


def _taken(sink: io.BytesIO) -> bytes:
    """Return the bytes that were written since the last call, and empty the sink."""
    written = sink.getvalue()
    sink.seek(0)
    sink.truncate()
    return written


PIECE: dict[Resolution, int] = {"readings": HOUR, "minutes": 7 * DAY, "hours": 90 * DAY}
"""The span of one read, µs."""


class Cell(NamedTuple):
    """A value, and the decimals with which it is written (None: as many as it has)."""

    value: float
    decimals: int | None


class ExportRow(NamedTuple):
    """A row: an instant (µs), a cell for each column (None: no reading then), a note. ``ends``: the columns
    whose units have no readings after it."""

    at: int
    cells: tuple[Cell | None, ...]
    note: str = ""
    ends: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Table:
    """The columns of an export, and its resolution. ``carries``: whether a value that was steady from before
    the start has a row at the start, even if the unit did not respond then. ``shown``: what people chose, in
    which a draw stands for the two speeds of ``queries``; empty for ``queries`` themselves."""

    queries: Sequence[SeriesQuery]
    fineness: Resolution
    time_zone: str
    carries: bool = False
    shown: Sequence[SeriesQuery] = ()

    @property
    def columns(self) -> list[str]:
        """A name for each column, with its unit of measure."""
        parts = ("",) if self.fineness == "readings" else (" min", " max", " avg")
        return [_column(query, part) for query in self.queries for part in parts]

    def named(self, language: Language) -> list[str]:
        """Return a name for each column for people: the name of the unit, of its wiring, and the measure."""
        rollup = (language.t("minimum"), language.t("maximum"), language.t("average"))
        parts = [""] if self.fineness == "readings" else [f" {word}" for word in rollup]
        shown = self.shown or self.queries
        names = [_name(query, language) for query in shown]
        places = [f" ({query.bus.name}/{query.unit})" for query in shown]
        return [
            f"{name}{place if names.count(name) > 1 else ''}{part}{_measure(query)}"
            for query, name, place in zip(shown, names, places, strict=True)
            for part in parts
        ]

    def as_shown(self, row: ExportRow) -> ExportRow:
        """Return a row with one cell for each curve of ``shown``; a draw is computed from its two speeds."""
        parts = 1 if self.fineness == "readings" else 3
        stored = [(each.bus.name, each.unit, each.value.name) for each in self.queries]
        cells: list[Cell | None] = []
        for query in self.shown or self.queries:
            places = [parts * stored.index((q.bus.name, q.unit, q.value.name)) for q in stored_queries(query)]
            if query.value.kind == "draw":
                before, section = (row.cells[place + parts - 1] for place in places)
                draw = draw_percent(before and before.value, section and section.value)
                cells += [None if draw is None else Cell(draw + 0.0, STORED_DECIMALS)] * parts
            else:
                cells += row.cells[places[0] : places[0] + parts]
        return row._replace(cells=tuple(cells))


def _name(query: SeriesQuery, language: Language) -> str:
    unit = values.unit_settings(query.bus, query.unit)
    return f"{unit.name} {values.label(unit, query.value) or values.text(query.value, language.t)}"


def _measure(query: SeriesQuery) -> str:
    measure = values.measure(values.unit_settings(query.bus, query.unit), query.value)
    return f" [{measure}]" if measure else ""


def _column(query: SeriesQuery, part: str) -> str:
    return f"{query.bus.name}/{query.unit} {query.value.name}{part}{_measure(query)}"


async def pieces(history: History, table: Table) -> AsyncIterator[list[ExportRow]]:
    """Yield all rows in order of time, piece by piece, each of which is one short read of the store."""
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
    """Return the span of all data, µs. It includes the tail, and the time until now, since data may be added
    until the export ends."""
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
        (stored_unit(connection, tail, *unit, part[0].start, part[0].end), list(group))
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
    source: StoredUnit,
    wanted: Sequence[tuple[int, SeriesQuery]],
    width: int,
    last_until: dict[tuple[str, int], int],
    carries: bool,
) -> Iterator[ExportRow]:
    first = wanted[0][1]
    unit = (first.bus.name, first.unit)
    # A run lies within a minute: one that began before the first piece may continue in that piece only.
    found = runs_between(source, first.start - MINUTE, first.end)
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
        # The unit has not come back: nothing is known of it until it does.
        yield ExportRow(runs[-1].until + 1, nothing, ends=places)


def _holes(source: StoredUnit, before: int | None, runs: Sequence[Run]) -> dict[int, int]:
    """Return the positions of runs after a hole, each with the begin of the hole, µs."""
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
    source: StoredUnit,
    wanted: Sequence[tuple[int, SeriesQuery]],
    width: int,
    fineness: Literal["minutes", "hours"],
) -> Iterator[ExportRow]:
    for place, query in wanted:
        points = rollups(source, fineness, query.value, query.start, query.end)
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
    """Join rows of the same instant."""
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
"""The number of rows from which on a longer step is used; the longest step takes any number."""


def step_of(start: int, end: int) -> int:
    """Return the distance of two rows over a span, µs."""
    return next((step for step in STEPS if (end - start) / step <= MAX_ROWS), STEPS[-1])


class Together:
    """The conversion of single readings to rows at common times, piece by piece: each value holds from its
    reading until the next one, or until the hole after it."""

    def __init__(self, width: int, step: int) -> None:
        self._step = step
        self._cells: list[Cell | None] = [None] * width
        self._next: int | None = None

    def rows(self, rows: Iterable[ExportRow]) -> Iterator[ExportRow]:
        """Yield the rows at each step up to the last of ``rows``."""
        for row in rows:
            yield from self._until(row.at)
            if self._next is None:
                self._next = -(-row.at // self._step) * self._step
            self._take(row)

    def end(self, end: int) -> Iterator[ExportRow]:
        """Yield the row that is left after the last piece, if it is before the end."""
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

"""An export as a download: CSV (RFC 4180), or Parquet where it is installed."""

from __future__ import annotations

import asyncio
import importlib.util
import io
from collections.abc import AsyncIterator, Iterable, Sequence
from datetime import datetime, tzinfo
from typing import TYPE_CHECKING, Any, Literal
from zoneinfo import ZoneInfo

import structlog
from starlette.responses import StreamingResponse

from app.core.web.csv_file import FOR_PROGRAMS, Column, CsvForm, Number
from app.core.web.csv_file import Cell as CsvCell
from app.errors import Problem
from app.line.history import tables
from app.line.history.export_rows import ExportRow, Table, Together, pieces, step_of
from app.line.history.query import Resolution, SeriesQuery, has_raw
from app.line.history.series.runs import SECOND
from app.line.history.service import History
from app.line.history.tail import Tail
from bus.messages import Message, term

Format = Literal["csv", "parquet"]
ExportResolution = Literal["auto", Resolution]
Layout = Literal["readings", "table"]
"""A row for each reading, or for each time with every value filled in."""


async def export_response(
    history: History,
    queries: Sequence[SeriesQuery],
    file: Format,
    resolution: ExportResolution,
    form: CsvForm = FOR_PROGRAMS,
    layout: Layout = "readings",
) -> StreamingResponse:
    """Stream an export, so that it takes no more memory for a year. ``form`` and ``layout`` are those of CSV.
    Raises StoreError or Problem before it begins."""
    if file == "parquet" and not await _parquet_is_usable():
        raise Problem(501, "no_parquet", Message("no_parquet"))
    fineness = await _fineness(history, queries, resolution)
    table = Table(queries, fineness, history.time_zone, carries=layout == "table")
    name = f"lineside-{_stamp(queries[0].start, table)}-{_stamp(queries[0].end, table)}.{file}"
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-store"}
    rows = pieces(history, table)
    if file == "csv":
        text = (stream_csv if layout == "readings" else stream_table)(table, rows, form)
        return StreamingResponse(text, 200, headers, "text/csv; charset=utf-8")
    media = "application/vnd.apache.parquet"
    return StreamingResponse(_stream_parquet(table, rows), 200, headers, media)


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
    """Text, piece by piece: one row for each reading, by the clock of the site."""
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
    """Text, piece by piece: one row a time with every value, for people, under the name of its unit."""
    assert form.language is not None
    site = ZoneInfo(table.time_zone)
    start, end = table.queries[0].start, table.queries[0].end
    together = Together(len(table.columns), step_of(start, end)) if table.fineness == "readings" else None
    values = (Column(name, name) for name in table.named(form.language))
    columns = [Column("time", term("Time"), is_time=True), *values]
    yield form.head(columns)

    def text(rows: Iterable[ExportRow]) -> str:
        return form.rows(columns, (_cells(row, site) for row in rows))

    async for rows in pieces:
        yield await asyncio.to_thread(text, rows if together is None else together.rows(rows))
    if together is not None:
        yield text(together.end(end))


def _cells(row: ExportRow, site: tzinfo) -> list[CsvCell]:
    values = (None if cell is None else _number(cell.value, cell.decimals) for cell in row.cells)
    return [datetime.fromtimestamp(row.at / SECOND, site), *values]


def _number(value: float, decimals: int | None) -> Number:
    return Number(repr(value) if decimals is None else f"{value:.{decimals}f}")


if TYPE_CHECKING:
    import pyarrow

log = structlog.get_logger()
GROUP_ROWS = 20_000
"""Rows in memory before they are written as one row group."""


def has_parquet() -> bool:
    """Whether pyarrow, an extra, is installed."""
    return importlib.util.find_spec("pyarrow") is not None


async def _parquet_is_usable() -> bool:
    """Whether pyarrow can be imported, too, with everything that it needs."""
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
    """Take the bytes that were written since the last call; the writer counts where in the file it is."""
    written = sink.getvalue()
    sink.seek(0)
    sink.truncate()
    return written

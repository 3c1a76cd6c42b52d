"""An export as a download: CSV (RFC 4180), or Parquet where it is installed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable, Sequence
from datetime import datetime, tzinfo
from typing import Literal
from zoneinfo import ZoneInfo

from starlette.responses import StreamingResponse

from app.errors import Problem
from app.history import parquet_file, tables
from app.history.export_rows import ExportRow, Table, pieces
from app.history.query import Resolution, SeriesQuery, has_raw
from app.history.series.runs import SECOND
from app.history.service import History
from app.history.tail import Tail
from app.history.together import Together, step_of
from app.web.rendering.csv_file import FOR_PROGRAMS, Column, CsvForm, Number
from app.web.rendering.csv_file import Cell as CsvCell
from bus.messages import Message, term

Format = Literal["csv", "parquet"]
ExportResolution = Literal["auto", Resolution]
Layout = Literal["readings", "table"]
"""A row for each reading, or for each time with every value filled in."""


async def response(
    history: History,
    queries: Sequence[SeriesQuery],
    file: Format,
    resolution: ExportResolution,
    form: CsvForm = FOR_PROGRAMS,
    layout: Layout = "readings",
) -> StreamingResponse:
    """Stream an export, so that it takes no more memory for a year. ``form`` and ``layout`` are those of CSV.
    Raises StoreError or Problem before it begins."""
    if file == "parquet" and not await parquet_file.is_usable():
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
    return StreamingResponse(parquet_file.stream(table, rows), 200, headers, media)


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

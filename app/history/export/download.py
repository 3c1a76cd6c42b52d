"""An export as a download: CSV (RFC 4180), or Parquet where it is installed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable, Sequence
from datetime import datetime, tzinfo
from typing import Literal
from zoneinfo import ZoneInfo

from starlette.responses import StreamingResponse

from app.errors import Problem
from app.history.export import parquet_file
from app.history.export.rows import Cell, ExportRow, Table, pieces
from app.history.export.together import Together, step_of
from app.history.intake.tail import Tail
from app.history.query.query import Resolution, SeriesQuery, has_raw
from app.history.series.runs import SECOND
from app.history.service import History
from app.history.store import tables
from app.messages import Language
from app.web.api.shape import csv_cell, csv_text
from bus.messages import Message

Format = Literal["csv", "parquet"]
ExportResolution = Literal["auto", Resolution]
Layout = Literal["readings", "table"]
"""A row for each reading, or for each time with every value filled in."""
BYTE_ORDER_MARK = "\ufeff"


async def response(
    history: History,
    queries: Sequence[SeriesQuery],
    file: Format,
    resolution: ExportResolution,
    named_in: Language | None = None,
) -> StreamingResponse:
    """Streamed, so that it takes no more memory for a year. ``named_in``: the language of the columns of a
    CSV with one row a time; None: a row for each reading. Raises StoreError or Problem before it begins."""
    if file == "parquet" and not await parquet_file.is_usable():
        raise Problem(501, "no_parquet", Message("no_parquet"))
    fineness = await _fineness(history, queries, resolution)
    table = Table(queries, fineness, history.time_zone, carries=named_in is not None)
    name = f"lineside-{_stamp(queries[0].start, table)}-{_stamp(queries[0].end, table)}.{file}"
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-store"}
    rows = pieces(history, table)
    if file == "csv":
        text = stream_csv(table, rows) if named_in is None else stream_table(table, rows, named_in)
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


async def stream_csv(table: Table, pieces: AsyncIterator[list[ExportRow]]) -> AsyncIterator[str]:
    """Text, piece by piece. Times are ISO 8601 with the offset of the site's time zone."""
    site = ZoneInfo(table.time_zone)
    yield csv_text([[f"time [{site}]", *table.columns, "note"]])
    async for rows in pieces:
        yield await asyncio.to_thread(csv_text, (_line(row, site) for row in rows))


async def stream_table(
    table: Table, pieces: AsyncIterator[list[ExportRow]], language: Language
) -> AsyncIterator[str]:
    """One row a time, text, piece by piece: local time as a spreadsheet reads it, the offset from UTC, and
    every value under the name of its unit."""
    site = ZoneInfo(table.time_zone)
    start, end = table.queries[0].start, table.queries[0].end
    together = Together(len(table.columns), step_of(start, end)) if table.fineness == "readings" else None
    # Spreadsheets take text for UTF-8 by this mark alone.
    names = map(csv_cell, table.named(language))
    yield BYTE_ORDER_MARK + csv_text([[language.t("Time"), language.t("UTC offset"), *names]])

    def text(rows: Iterable[ExportRow]) -> str:
        return csv_text(_table_line(row, site) for row in rows)

    async for rows in pieces:
        yield await asyncio.to_thread(text, rows if together is None else together.rows(rows))
    if together is not None:
        yield text(together.end(end))


def _table_line(row: ExportRow, site: tzinfo) -> list[str]:
    at = datetime.fromtimestamp(row.at / SECOND, site)
    return [f"{at:%Y-%m-%d %H:%M:%S}", at.isoformat(timespec="minutes")[16:], *map(_text, row.cells)]


def _line(row: ExportRow, site: tzinfo) -> list[str]:
    at = datetime.fromtimestamp(row.at / SECOND, site).isoformat(timespec="milliseconds")
    return [at, *map(_text, row.cells), row.note]


def _text(cell: Cell | None) -> str:
    if cell is None:
        return ""
    return repr(cell.value) if cell.decimals is None else f"{cell.value:.{cell.decimals}f}"

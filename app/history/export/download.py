"""An export as a download: CSV (RFC 4180), or Parquet where it is installed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from datetime import datetime, tzinfo
from typing import Literal
from zoneinfo import ZoneInfo

from starlette.responses import StreamingResponse

from app.errors import Problem
from app.history.export import parquet_file
from app.history.export.rows import Cell, ExportRow, Table, pieces
from app.history.intake.tail import Tail
from app.history.query.query import Resolution, SeriesQuery, has_raw
from app.history.series.runs import SECOND
from app.history.service import History
from app.history.store import tables
from app.web.shape import csv_text
from bus.messages import Message

Format = Literal["csv", "parquet"]
ExportResolution = Literal["auto", Resolution]


async def response(
    history: History, queries: Sequence[SeriesQuery], file: Format, resolution: ExportResolution
) -> StreamingResponse:
    """Streamed, so that it takes no more memory for a year. Raises StoreError or Problem before it begins."""
    if file == "parquet" and not await parquet_file.is_usable():
        raise Problem(501, "no_parquet", Message("no_parquet"))
    fineness = await _fineness(history, queries, resolution)
    table = Table(queries, fineness, history.time_zone)
    name = f"lineside-{_stamp(queries[0].start, table)}-{_stamp(queries[0].end, table)}.{file}"
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-store"}
    rows = pieces(history, table)
    if file == "csv":
        return StreamingResponse(stream_csv(table, rows), 200, headers, "text/csv; charset=utf-8")
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


def _line(row: ExportRow, site: tzinfo) -> list[str]:
    at = datetime.fromtimestamp(row.at / SECOND, site).isoformat(timespec="milliseconds")
    return [at, *map(_text, row.cells), row.note]


def _text(cell: Cell | None) -> str:
    if cell is None:
        return ""
    return repr(cell.value) if cell.decimals is None else f"{cell.value:.{cell.decimals}f}"

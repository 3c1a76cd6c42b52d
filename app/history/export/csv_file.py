"""An export as CSV (RFC 4180): a line of headings with units and time zone, then the rows."""

from __future__ import annotations

import asyncio
import csv
import io
from collections.abc import AsyncIterator, Sequence
from datetime import datetime, tzinfo
from zoneinfo import ZoneInfo

from app.history.export.rows import Cell, ExportRow, Table
from app.history.series.runs import SECOND


async def stream(table: Table, pieces: AsyncIterator[list[ExportRow]]) -> AsyncIterator[str]:
    """Text, piece by piece. Times are ISO 8601 with the offset of the site's time zone."""
    site = ZoneInfo(table.time_zone)
    yield lines([[f"time [{site}]", *table.columns, "note"]])
    async for rows in pieces:
        yield await asyncio.to_thread(_text_of, rows, site)


def _text_of(rows: Sequence[ExportRow], site: tzinfo) -> str:
    return lines([_line(row, site) for row in rows])


def _line(row: ExportRow, site: tzinfo) -> list[str]:
    at = datetime.fromtimestamp(row.at / SECOND, site).isoformat(timespec="milliseconds")
    return [at, *map(_text, row.cells), row.note]


def _text(cell: Cell | None) -> str:
    if cell is None:
        return ""
    return repr(cell.value) if cell.decimals is None else f"{cell.value:.{cell.decimals}f}"


def lines(rows: Sequence[Sequence[str]]) -> str:
    """Rows as CSV."""
    buffer = io.StringIO()
    csv.writer(buffer).writerows(rows)
    return buffer.getvalue()

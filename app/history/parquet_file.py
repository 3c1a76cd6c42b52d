"""An export as Parquet: a timestamp column with zone, a float column for each value, a note.

pyarrow is large and therefore imported at the first such export.
"""

from __future__ import annotations

import asyncio
import importlib.util
import io
from collections.abc import AsyncIterator, Sequence
from typing import TYPE_CHECKING, Any

import structlog

from app.history.export_rows import ExportRow, Table

if TYPE_CHECKING:
    import pyarrow

log = structlog.get_logger()
GROUP_ROWS = 20_000
"""Rows in memory before they are written as one row group."""


def is_installed() -> bool:
    """Whether pyarrow, an extra, is installed."""
    return importlib.util.find_spec("pyarrow") is not None


async def is_usable() -> bool:
    """Whether pyarrow can be imported, too, with everything that it needs."""
    return is_installed() and await asyncio.to_thread(_can_import)


def _can_import() -> bool:
    try:
        importlib.import_module("pyarrow.parquet")
    except Exception as error:  # a library that does not fit raises anything
        log.warning("pyarrow cannot be used", error=repr(error))
        return False
    return True


async def stream(table: Table, pieces: AsyncIterator[list[ExportRow]]) -> AsyncIterator[bytes]:
    """Bytes, row group by row group."""
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

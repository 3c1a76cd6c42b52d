"""An export in a process for itself: ``python -m tests.app.measured_export FOLDER FORMAT FROM TO`` prints,
as JSON, by how many MB its memory grew. The times are in µs."""

from __future__ import annotations

import asyncio
import json
import resource
import sys
from pathlib import Path
from typing import cast

import pyarrow.parquet

from app.line.history.api import Span, series_queries
from app.line.history.export import Format, export_response
from app.line.history.service import History
from bus.settings import BusSettings, UnitSettings

assert pyarrow.parquet, "loading it is no growth"


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


async def main(folder: Path, file: Format, span: Span) -> None:
    bus = BusSettings(name="line", port="/dev/null", unit=(UnitSettings(id=1, name="Nip"),))
    history = History(folder, [bus])
    history.start()
    queries = series_queries(history, ["line/1/actual", "line/1/analog", "line/1/run"], span, 1)
    before = peak_mb()
    exported = await export_response(history, queries, file, "minutes")
    with (folder / "export").open("wb") as out:
        async for part in exported.body_iterator:
            out.write(part.encode() if isinstance(part, str) else part)
    print(json.dumps({"grown_mb": peak_mb() - before}))
    history.close()


if __name__ == "__main__":
    place, kind, begin, end = sys.argv[1:]
    asyncio.run(main(Path(place), cast(Format, kind), Span(int(begin), int(end))))

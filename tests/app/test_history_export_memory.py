"""Exporting a long span does not fill memory: measured in a separate process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from app.database.connection import Database
from app.history.intake.writer import MIGRATIONS
from app.history.series.rollup import Rollup, combine, pack_rollups
from app.history.series.runs import DAY, HOUR, MINUTE, micros
from app.history.service import FILE
from app.history.store import tables

pytestmark = pytest.mark.soak

DAYS = 60
ROWS = DAYS * 1440
MOST_MB = 100
"""All rows at once would be half as much again and more."""
EXPORT = """\
import asyncio, json, resource, sys
from pathlib import Path
import pyarrow.parquet
from app.history.export.download import response
from app.history.service import History
from app.history.api.spans import Span, series_queries
from app.settings import Server, Settings
from bus.settings import BusSettings, UnitSettings

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

async def main(folder, file, start, end):
    bus = BusSettings(name="line", port="/dev/null", unit=(UnitSettings(id=1, name="Nip"),))
    history = History(Settings(server=Server(data=Path(folder)), bus=(bus,)))
    history.start()
    queries = series_queries(history, ["line/1/actual", "line/1/analog", "line/1/run"], Span(start, end), 1)
    before, count = peak(), 0
    answer = await response(history, queries, file, "minutes")
    with open(Path(folder) / "export", "wb") as out:
        async for part in answer.body_iterator:
            count += out.write(part.encode() if isinstance(part, str) else part)
    print(json.dumps({"grown": peak() - before, "bytes": count}))
    history.close()

folder, file, start, end = sys.argv[1:]
asyncio.run(main(folder, file, int(start), int(end)))
"""


@pytest.fixture(scope="module")
def months(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """A store with the minutes of some months, and when that ends."""
    folder = tmp_path_factory.mktemp("months")
    end = micros(time.time()) // DAY * DAY
    minutes = [_minute(n) for n in range(60)]
    blob = pack_rollups(minutes, 0)
    hours = pack_rollups([combine(minutes, hour * HOUR) for hour in range(24)], 0)

    def write(connection: tables.StoreConnection) -> None:
        unit = tables.unit_id(connection, "line", 1)
        starts = range(end - DAYS * DAY, end, HOUR)
        insert = "INSERT INTO {} VALUES (?, ?, ?)"
        connection.executemany(insert.format("minutes"), [(unit, start, blob) for start in starts])
        days = range(end - DAYS * DAY, end, DAY)
        connection.executemany(insert.format("hours"), [(unit, day, hours) for day in days])
        tables.write_raw_from(connection, end)

    database = Database(folder / FILE, MIGRATIONS)
    database.write_now(write)
    database.close()
    return folder, end


def _minute(number: int) -> Rollup:
    low, high = 1000 + number, 1100 - number
    reach = (low, high, 300 * (low + high) // 2)
    return Rollup(number * MINUTE, 300, *reach, *reach, *reach, 3, 3, (300, 300, *[0] * 14))


@pytest.mark.parametrize("file", ["csv", "parquet"])
def test_months_do_not_fill_memory(months: tuple[Path, int], file: str) -> None:
    folder, end = months
    span = (str(end - DAYS * DAY), str(end))
    done = subprocess.run(
        [sys.executable, "-c", EXPORT, str(folder), file, *span], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    measured = json.loads(done.stdout.splitlines()[-1])
    if file == "csv":
        with (folder / "export").open() as lines:
            assert sum(1 for _ in lines) == ROWS + 1
    else:
        from pyarrow import parquet

        assert parquet.ParquetFile(folder / "export").metadata.num_rows == ROWS
    assert measured["grown"] < MOST_MB, measured

"""Exporting a long span does not fill memory: measured in a separate process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pyarrow import parquet

from app.core.database import Database
from app.line.history import tables
from app.line.history.series.rollup import Rollup, combine, pack_rollups
from app.line.history.series.runs import DAY, HOUR, MINUTE, micros
from app.line.history.service import FILE
from app.line.history.writer import MIGRATIONS
from tests.app import measured_export
from tests.sizes import sizes

MAX_GROWTH_MB = 100
"""All rows at once would be half as much again and more."""


@pytest.fixture(scope="module", params=sizes(1, 60))
def days(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(scope="module")
def months(tmp_path_factory: pytest.TempPathFactory, days: int) -> tuple[Path, int]:
    """A store with the minutes of so many days, and when that ends."""
    folder = tmp_path_factory.mktemp("months")
    end = micros(time.time()) // DAY * DAY
    minutes = [_minute(n) for n in range(60)]
    blob = pack_rollups(minutes, 0)
    hours = pack_rollups([combine(minutes, hour * HOUR) for hour in range(24)], 0)

    def write(connection: tables.StoreConnection) -> None:
        unit = tables.unit_id(connection, "line", 1)
        starts = range(end - days * DAY, end, HOUR)
        insert = "INSERT INTO {} VALUES (?, ?, ?)"
        connection.executemany(insert.format("minutes"), [(unit, start, blob) for start in starts])
        midnights = range(end - days * DAY, end, DAY)
        connection.executemany(insert.format("hours"), [(unit, day, hours) for day in midnights])
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
def test_months_do_not_fill_memory(months: tuple[Path, int], days: int, file: str) -> None:
    folder, end = months
    span = (str(end - days * DAY), str(end))
    done = subprocess.run(
        [sys.executable, "-m", measured_export.__name__, str(folder), file, *span],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    measured = json.loads(done.stdout.splitlines()[-1])
    rows = days * 1440
    if file == "csv":
        with (folder / "export").open() as lines:
            assert sum(1 for _ in lines) == rows + 1
    else:
        assert parquet.ParquetFile(folder / "export").metadata.num_rows == rows
    assert measured["grown_mb"] < MAX_GROWTH_MB, measured

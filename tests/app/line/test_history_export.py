"""An export as a table has every value in force at a time, and none after a hole; a long span does not fill
memory, as a separate process shows."""

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
from app.line.history.export import MAX_ROWS, STEPS, Cell, ExportRow, Together, step_of
from app.line.history.series.runs import DAY, HOUR, MINUTE, SECOND, Rollup, combine, micros, pack_rollups
from app.line.history.service import FILE
from app.line.history.writer import MIGRATIONS
from tests.app import measured_export

S = SECOND


def row(seconds: float, *values: float | None, ends: tuple[int, ...] = ()) -> ExportRow:
    cells = tuple(None if value is None else Cell(value, 0) for value in values)
    return ExportRow(round(seconds * S), cells, "", ends)


def together(*pieces: list[ExportRow], end: float = 100) -> list[tuple[float, list[float | None]]]:
    table = Together(2, S)
    rows = [each for piece in pieces for each in table.rows(piece)] + list(table.end(round(end * S)))
    return [(row.at / S, [cell and cell.value for cell in row.cells]) for row in rows]


def test_units_that_respond_at_different_times_share_rows() -> None:
    assert together([row(1.2, 10, None), row(1.4, None, 7), row(2.1, 11, None), row(2.3, None, 8)]) == [
        (2, [10, 7]),
        (3, [11, 8]),
    ]


def test_a_reading_at_the_time_itself_counts_and_a_steady_value_holds_over_pieces() -> None:
    assert together([row(1, 10, 7)], [row(3, 11, 7)]) == [(1, [10, 7]), (2, [10, 7]), (3, [11, 7])]


def test_a_hole_ends_the_values_of_its_unit_alone() -> None:
    found = together([row(1, 10, 7), row(1.5, None, None, ends=(0,)), row(3, None, 8), row(4, 12, 8)])
    assert found == [(1, [10, 7]), (2, [None, 7]), (3, [None, 8]), (4, [12, 8])]


def test_a_time_at_which_nothing_is_known_has_no_row() -> None:
    found = together([row(1, 10, 7), row(1.5, None, None, ends=(0, 1)), row(900.5, 12, 8)], end=1000)
    assert found == [(1, [10, 7]), (901, [12, 8])]


def test_nothing_follows_the_end() -> None:
    assert together([row(1.5, 10, 7)], end=1.8) == []
    assert together([]) == []


def test_a_long_span_has_a_longer_step() -> None:
    assert step_of(0, 3600 * S) == S
    assert step_of(0, 3 * DAY) == 5 * S
    assert step_of(0, 3650 * DAY) == STEPS[-1]
    assert 3 * DAY / step_of(0, 3 * DAY) <= MAX_ROWS


MAX_GROWTH_MB = 100
"""All rows at once would be half as much again and more."""


DAYS = 60


@pytest.fixture(scope="module")
def months(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """A store with the minutes of these days, and when that ends."""
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
        midnights = range(end - DAYS * DAY, end, DAY)
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


@pytest.mark.soak
@pytest.mark.parametrize("file", ["csv", "parquet"])
def test_months_do_not_fill_memory(months: tuple[Path, int], file: str) -> None:
    folder, end = months
    span = (str(end - DAYS * DAY), str(end))
    done = subprocess.run(
        [sys.executable, "-m", measured_export.__name__, str(folder), file, *span],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    measured = json.loads(done.stdout.splitlines()[-1])
    rows = DAYS * 1440
    if file == "csv":
        with (folder / "export").open() as lines:
            assert sum(1 for _ in lines) == rows + 1
    else:
        assert parquet.ParquetFile(folder / "export").metadata.num_rows == rows
    assert measured["grown_mb"] < MAX_GROWTH_MB, measured

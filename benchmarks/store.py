"""The history of 200 lines in SQLite and in PostgreSQL: cost of writing, bytes, time of reading."""

from __future__ import annotations

import gc
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from app.database import Database, SqliteDatabase
from app.database.settings import StoreSettings
from app.history.intake.opening import MIGRATIONS
from app.history.intake.recorder import Recorder
from app.history.intake.tail import Tail
from app.history.intake.updates import Delivery
from app.history.intake.writer import COMMIT_EVERY_S
from app.history.query.query import SeriesQuery, run_query
from app.history.series.runs import DAY, HOUR, micros
from app.history.series.values import VALUES
from benchmarks.database_server import DatabaseServer, database_server
from benchmarks.history_store import POLL, fill, readings
from benchmarks.tables import median, milliseconds, quantile, show
from bus.contract import Reading
from bus.instants import Monotonic
from bus.settings import BusSettings, UnitSettings

LINES, UNITS = 200, 8
READINGS_A_SECOND = 8_000
START = 1_795_219_200.0
WRITTEN_S = 62.5
"""Of the plant: a minute, until it is folded into blocks."""
YEAR_DAYS, RAW_DAYS = 365, 5
QUERIES = 20
SIZE_OF_SCHEMA = """
SELECT sum(pg_total_relation_size(oid)) FROM pg_class
WHERE relnamespace = 'history'::regnamespace AND relkind = 'r'
"""
_NO_DEADLINE = Monotonic(float("inf"))


@dataclass(frozen=True)
class Written:
    """What it took: CPU seconds of this process and of the database server; how many readings it was for."""

    app_s: float
    server_s: float
    count: int


def run() -> None:
    """Every table."""
    with tempfile.TemporaryDirectory() as folder, database_server() as server:
        _show_writing(Path(folder), server)
        _show_reading(Path(folder), server)


def _show_writing(folder: Path, server: DatabaseServer) -> None:
    deliveries = list(_deliveries())
    with _sqlite(folder / "written.db") as database:
        ours = _written(database, deliveries, lambda: 0.0)
    with _postgresql(server.store("written")) as database:
        theirs = _written(database, deliveries, server.cpu_s)
    rows = [
        [name, _share(each.app_s), _share(each.server_s)]
        for name, each in (("SQLite", ours), ("PostgreSQL", theirs))
    ]
    rows.append(["ratio", f"{theirs.app_s / ours.app_s:.2f}", ""])
    note = (
        f"{READINGS_A_SECOND} readings a second of {LINES} lines for {WRITTEN_S} s of the plant, "
        f"{ours.count} in all, a commit each {COMMIT_EVERY_S} s; blocks of minutes.\n  "
        "CPU time as a share of one core. Must reach: 5 % in the app, 5 % in PostgreSQL."
    )
    show("History of 200 lines, written", ["", "app", "PostgreSQL"], rows, note)


def _share(cpu_s: float) -> str:
    return f"{100 * cpu_s / WRITTEN_S:.1f} %"


def _deliveries() -> Iterator[list[Delivery]]:
    """What each commit writes. Every line has the same readings, made once."""
    rate = READINGS_A_SECOND / LINES / UNITS
    times = 1e6 / POLL / rate
    each = [list(readings(unit, START, WRITTEN_S / times)) for unit in range(1, UNITS + 1)]
    spread = [_spread(reading, times) for line in each for reading in line]
    commits: dict[int, list[Reading]] = {}
    for reading in sorted(spread, key=lambda reading: reading.at):
        commits.setdefault(int((reading.at - START) / COMMIT_EVERY_S), []).append(reading)
    for batch in commits.values():
        yield [(f"line-{line}", batch) for line in range(LINES)]


def _spread(reading: Reading, times: float) -> Reading:
    at = START + (reading.at - START) * times
    return Reading(reading.unit, at, *_values(reading))


def _values(reading: Reading) -> tuple[int, int, int, int, int]:
    return reading.commanded, reading.actual, reading.analog, reading.outputs, reading.inputs


def _written(database: Database, deliveries: list[list[Delivery]], server_s: Callable[[], float]) -> Written:
    recorder = Recorder(database, Tail(), lambda _: None)
    # As in a server: what was loaded is in no collection.
    gc.collect()
    gc.freeze()
    began, server_began = time.process_time(), server_s()
    for number, delivery in enumerate(deliveries):
        recorder.commit(delivery)
        recorder.fold(micros(START + (number + 1) * COMMIT_EVERY_S), _NO_DEADLINE)
    app_s, spent_s = time.process_time() - began, server_s() - server_began
    count = sum(len(batch) for delivery in deliveries for _, batch in delivery)
    return Written(app_s, spent_s, count)


def _show_reading(folder: Path, server: DatabaseServer) -> None:
    rows, sizes = [], []
    path, settings = folder / "read.db", server.store("read")
    for name, opened, size in (
        ("SQLite", _sqlite(path), lambda: _bytes_of_file(path)),
        ("PostgreSQL", _postgresql(settings), lambda: _bytes_of_schema(settings)),
    ):
        with opened as database:
            end = micros(START) - micros(START) % HOUR
            count = fill(database, ("line", UNITS), end, raw_days=RAW_DAYS, days=RAW_DAYS)
            sizes.append(size() / count)
            fill(database, ("year", 1), end, raw_days=1, days=YEAR_DAYS)
            year = _times(partial(_query, database, "year", 1, end, YEAR_DAYS))
            eight = _times(partial(_query, database, "line", UNITS, end, 1))
            rows.append([name, *(milliseconds(f(t)) for t in (year, eight) for f in (median, _p95))])
    ratio = f"{sizes[1] / sizes[0]:.2f}"
    note = f"{RAW_DAYS} days of {UNITS} units in blocks of hours, with rollups. Must reach: ratio 1.2."
    numbers = [[row[0], f"{size:.2f}"] for row, size in zip(rows, sizes, strict=True)]
    show("History, bytes", ["", "a reading"], [*numbers, ["ratio", ratio]], note)
    header = ["", "a year, median", "p95", "8 values, a day, median", "p95"]
    show(
        "History, read", header, rows, "1,000 points each. Must reach: a year 150 ms, 8 values 500 ms (p95)."
    )


def _times(work: Callable[[], None]) -> list[float]:
    work()
    taken = []
    for _ in range(QUERIES):
        began = time.perf_counter()
        work()
        taken.append(time.perf_counter() - began)
    return taken


def _p95(values: list[float]) -> float:
    return quantile(values, 0.95)


def _query(database: Database, bus: str, units: int, end: int, days: int) -> None:
    numbers = range(1, units + 1)
    line = BusSettings(
        name=bus, port="/dev/null", unit=tuple(UnitSettings(id=n, name=f"Unit {n}") for n in numbers)
    )
    for number in numbers:
        query = SeriesQuery(line, number, VALUES["actual"], end - days * DAY, end, 1000)
        found = database.read_now(lambda connection, query=query: run_query(connection, Tail(), query))
        assert len(found.series.at) > 200


@contextmanager
def _sqlite(path: Path) -> Iterator[Database]:
    with closing(SqliteDatabase(path, MIGRATIONS, synchronous="NORMAL")) as database:
        yield database


@contextmanager
def _postgresql(store: StoreSettings) -> Iterator[Database]:
    from app.database.postgresql.database import PostgresqlDatabase

    with closing(PostgresqlDatabase(store, "history", MIGRATIONS)) as database:
        yield database


def _bytes_of_file(path: Path) -> int:
    """Bytes in pages with content."""
    with closing(sqlite3.connect(path)) as connection:
        names = ("page_count", "freelist_count", "page_size")
        pages, free, size = (connection.execute(f"PRAGMA {name}").fetchone()[0] for name in names)
    return int((pages - free) * size)


def _bytes_of_schema(store: StoreSettings) -> int:
    """Bytes of tables, their indexes and what is stored beside them, without rows that were deleted."""
    import psycopg

    with psycopg.connect(store.url, autocommit=True) as connection:
        connection.execute("VACUUM FULL")
        row = connection.execute(SIZE_OF_SCHEMA.encode()).fetchone()
    assert row is not None
    return int(row[0])

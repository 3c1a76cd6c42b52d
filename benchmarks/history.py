"""History: how fast it stores, how small it is, how soon it responds, how soon a trend is drawn."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

from app.core.database import Database
from app.line.history import tables
from app.line.history.query import SeriesQuery, run_query
from app.line.history.recorder import Recorder, Tail, compact
from app.line.history.series.runs import DAY, micros
from app.line.history.series.values import VALUES
from app.line.history.writer import MIGRATIONS
from benchmarks.history_store import build, readings
from benchmarks.tables import median, milliseconds, quantile, show
from bus.contract import Reading
from bus.settings import BusSettings, UnitSettings
from tests.e2e.conftest import CHROMIUM, FLAGS, signed_in
from tests.e2e.site import Site, site

STORED = 200_000
COMMIT = 2_500
"""Readings in one commit: half a second at 5,000 a second."""
UNITS = 8
START = 1_795_219_200.0
NAIVE_DAYS = 3
QUERIES = 15
FLOOD_S = 20.0
PAGES = 7
NAIVE = (
    "CREATE TABLE naive (unit INTEGER, at REAL, commanded INTEGER, actual INTEGER, analog INTEGER, "
    "outputs INTEGER, inputs INTEGER)"
)
NAIVE_INDEX = "CREATE INDEX naive_by_time ON naive (unit, at)"
NAIVE_INSERT = "INSERT INTO naive VALUES (?, ?, ?, ?, ?, ?, ?)"
NAIVE_QUERY = (
    "SELECT min(at), min(actual), max(actual), avg(actual) FROM naive WHERE unit = 1 AND at >= ? AND at < ? "
    "GROUP BY CAST((at - ?) / ? AS INTEGER)"
)


def run() -> None:
    """Every table."""
    with tempfile.TemporaryDirectory() as folder:
        _show_rate(Path(folder))
        _show_size(Path(folder))
        _show_queries(Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        _show_page(Path(folder))


def _line_of_readings(count: int) -> list[Reading]:
    """The readings of eight units, in the order in which a bus brings them."""
    each = [readings(unit, START, count / UNITS) for unit in range(1, UNITS + 1)]
    return list(islice((reading for turn in zip(*each, strict=False) for reading in turn), count))


def _seconds(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def _show_rate(folder: Path) -> None:
    line = _line_of_readings(STORED)
    batches = [line[i : i + COMMIT] for i in range(0, len(line), COMMIT)]
    recorder = _recorder(folder / "rate.db")

    def commit_all() -> None:
        for batch in batches:
            recorder.commit([("line", batch)])

    ours = _seconds(commit_all)
    folding = _seconds(recorder.fold_everything)
    bare = sqlite3.connect(folder / "bare.db", isolation_level=None)
    bare.execute("PRAGMA journal_mode = WAL")
    bare.execute(NAIVE)
    bare.execute(NAIVE_INDEX)

    def insert_all() -> None:
        for batch in batches:
            _insert(bare, batch)

    theirs = _seconds(insert_all)
    bare.close()
    rows = [
        [
            "Lineside: journal, blocks, rollups, bits",
            _rate(ours + folding),
            f"{theirs / (ours + folding):.2f}",
        ],
        ["  of it the commits alone", _rate(ours), f"{theirs / ours:.2f}"],
        ["bare sqlite3 insert of the same rows", _rate(theirs), "1.00"],
    ]
    note = f"{STORED} readings of {UNITS} units, {COMMIT} a commit; must reach 5,000 a second.\n  {_wire()}"
    show("Readings stored", ["", "a second", "ratio"], rows, note)


def _rate(seconds: float) -> str:
    return f"{STORED / seconds:,.0f}"


def _insert(connection: sqlite3.Connection, batch: list[Reading]) -> None:
    connection.execute("BEGIN")
    connection.executemany(
        NAIVE_INSERT, [(r.unit, r.at, r.commanded, r.actual, r.analog, r.outputs, r.inputs) for r in batch]
    )
    connection.execute("COMMIT")


def _recorder(path: Path) -> Recorder:
    return Recorder(Database(path, MIGRATIONS), Tail(), lambda _: None)


def _wire() -> str:
    """Polls a second of a bus of eight, quiet and beside a process that stores 5,000 readings a second."""
    with tempfile.TemporaryDirectory() as folder, site(Path(folder), UNITS, installed=True) as served:
        quiet = _polls(served)
        flood = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.history_victim", folder], stdout=subprocess.PIPE
        )
        busy = _polls(served)
        flood.kill()
        flood.communicate()
    return (
        f"A bus of {UNITS} beside it: {quiet:.1f} polls a second quiet, {busy:.1f} while 5,000 readings "
        f"a second are stored ({busy / quiet:.3f})."
    )


def _polls(served: Site) -> float:
    with served.api("viewer") as client:
        counts = []
        for _ in range(2):
            text = client.get(f"{served.url}/metrics").text.splitlines()
            polls = (row for row in text if row.startswith("lineside_polls_total{"))
            counts.append(sum(float(row.split()[-1]) for row in polls))
            if len(counts) == 1:
                time.sleep(FLOOD_S)
    return (counts[1] - counts[0]) / FLOOD_S


def _show_size(folder: Path) -> None:
    day = list(readings(1, START, 86_400))
    recorder = _recorder(folder / "day.db")
    for i in range(0, len(day), COMMIT):
        recorder.commit([("line", day[i : i + COMMIT])])
    recorder.fold_everything()
    _compact(folder / "day.db")
    naive = sqlite3.connect(folder / "naive_day.db")
    naive.execute(NAIVE)
    naive.execute(NAIVE_INDEX)
    with naive:
        _insert_plain(naive, day)
    naive.close()
    ours, theirs = (_bytes_in_use(folder / name) / len(day) for name in ("day.db", "naive_day.db"))
    rows = [
        ["Lineside, rollups and bits included", f"{ours:.2f}", f"{ours / theirs:.3f}"],
        ["a naive table with its index", f"{theirs:.2f}", "1.000"],
    ]
    note = f"A day of one of {UNITS} units, {len(day)} readings of trembling values; must be 8 at most."
    show("Bytes per reading after a day", ["", "bytes", "ratio"], rows, note)


def _compact(path: Path) -> None:
    """As it is once every hour is over."""
    database = Database(path, MIGRATIONS)
    while (
        found := database.read_now(lambda c: tables.next_to_compact(c, micros(START) + 2 * DAY))
    ) is not None:
        database.write_now(partial(_compact_one, found))
    database.close()


def _compact_one(hour: tuple[int, int], connection: sqlite3.Connection) -> None:
    compact(connection, *hour)


def _bytes_in_use(path: Path) -> int:
    """Return the bytes in pages with content, whatever the file has allocated on the disk."""
    with closing(sqlite3.connect(path)) as connection:
        names = ("page_count", "freelist_count", "page_size")
        pages, free, size = (connection.execute(f"PRAGMA {name}").fetchone()[0] for name in names)
    return int((pages - free) * size)


def _insert_plain(connection: sqlite3.Connection, rows: list[Reading]) -> None:
    connection.executemany(
        NAIVE_INSERT, [(r.unit, r.at, r.commanded, r.actual, r.analog, r.outputs, r.inputs) for r in rows]
    )


def _show_queries(folder: Path) -> None:
    end = micros(START)
    took = time.perf_counter()
    count = build(folder / "large.db", "line", UNITS, end, 30, 365)
    took = time.perf_counter() - took
    size = (folder / "large.db").stat().st_size
    database = Database(folder / "large.db", MIGRATIONS)
    naive = _naive(folder / "naive.db")
    rows = []
    for name, days in (
        ("10 minutes", 10 / 1440),
        ("8 hours", 1 / 3),
        ("a day", 1),
        ("30 days", 30),
        ("a year", 365),
    ):
        ours = [_seconds(partial(_query, database, end, days)) for _ in range(QUERIES)]
        part = min(days, NAIVE_DAYS)
        theirs = [_seconds(partial(_query_naive, naive, part)) for _ in range(3)]
        beside = milliseconds(median(theirs)) + ("" if part == days else f" for {NAIVE_DAYS} days")
        ratio = f"{median(theirs) / median(ours):.1f}"
        rows.append([name, milliseconds(median(ours)), milliseconds(quantile(ours, 0.95)), beside, ratio])
    database.close()
    naive.close()
    note = (
        f"One value of one unit, 1,000 points, from {count / 1e6:.0f} M readings and a year of rollups "
        f"({size / 1e6:.0f} MB, made in {took:.0f} s).\n  Must reach: 30 days 50 ms, a year 150 ms. "
        f"The naive table holds {NAIVE_DAYS} days of that unit."
    )
    show("A span drawn", ["", "median", "p95", "naive GROUP BY", "ratio"], rows, note)


def _line() -> BusSettings:
    units = tuple(UnitSettings(id=n, name=f"Unit {n}") for n in range(1, UNITS + 1))
    return BusSettings(name="line", port="/dev/null", unit=units)


def _query(database: Database, end: int, days: float) -> None:
    query = SeriesQuery(_line(), 1, VALUES["actual"], end - round(days * DAY), end, 1000)
    found = database.read_now(lambda connection: run_query(connection, Tail(), query))
    assert len(found.series.at) > 200


def _naive(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path)
    connection.execute(NAIVE)
    connection.execute(NAIVE_INDEX)
    with connection:
        _insert_plain(connection, list(readings(1, START - NAIVE_DAYS * 86_400, NAIVE_DAYS * 86_400)))
    return connection


def _query_naive(connection: sqlite3.Connection, days: float) -> None:
    begin = START - days * 86_400
    connection.execute(NAIVE_QUERY, (begin, START, begin, days * 86.4)).fetchall()


def _show_page(folder: Path) -> None:
    (folder / "data").mkdir()
    build(folder / "data" / "history.db", "line", UNITS, micros(time.time()), 2, 2)
    with site(folder, UNITS, installed=True) as served, sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        state = signed_in(chromium, served, "viewer")
        fresh, again = zip(*(_two_pictures(chromium, served.url, state) for _ in range(PAGES)), strict=True)
        chromium.close()
    rows = [
        ["the first after the server's start", milliseconds(fresh[0])],
        ["a browser that was never here, median", milliseconds(median(fresh[1:]))],
        ["the same browser again, median", milliseconds(median(again))],
    ]
    note = f"From the navigation to the curves; {os.cpu_count()} cores, polling goes on. Must be 500 ms."
    show("The trend page, 8 values over 1 day", ["", "drawn after"], rows, note)


def _two_pictures(chromium: Browser, url: str, state: Any) -> tuple[float, float]:
    """With nothing in its cache, and with everything."""
    context = chromium.new_context(base_url=url, storage_state=state)
    page = context.new_page()
    times = _first_picture(page), _first_picture(page)
    context.close()
    return times


def _first_picture(page: Page) -> float:
    page.goto("/trends?span=86400")
    page.wait_for_selector("#trends[data-drawn]")
    return float(page.evaluate("performance.getEntriesByName('trends-drawn')[0].startTime")) / 1000

"""Killed at random under load: every event is there, a second of readings at most is missing."""

from __future__ import annotations

import random
import sqlite3
import subprocess
import sys
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path

from app.core.database import Database
from app.line.history.recorder import Recorder, Tail
from app.line.history.writer import MIGRATIONS
from app.people.audit.keys import open_keys
from app.people.audit.proof import heads_of, prove
from benchmarks.history_victim import KEY_FILE
from benchmarks.tables import median, show

KILLS = 50


@dataclass(frozen=True, slots=True)
class After:
    """What one kill left."""

    events_missing: int
    readings_missing_s: float
    sound: bool


def run() -> None:
    """One table."""
    chance = random.Random(5)
    with tempfile.TemporaryDirectory() as folder:
        found = [kill_once(Path(folder), 0.5 + 2.5 * chance.random()) for _ in range(KILLS)]
    lost = [after.readings_missing_s for after in found]
    rows: list[list[object]] = [
        ["events missing", sum(after.events_missing for after in found), "0"],
        ["readings missing, median", f"{median(lost):.2f} s", ""],
        ["readings missing, worst", f"{max(lost):.2f} s", "1 s"],
        ["stores sound", sum(after.sound for after in found), str(KILLS)],
    ]
    show(
        f"SIGKILL {KILLS} times at random, 5,000 readings and 10 events a second",
        ["", "found", "must be"],
        rows,
    )


def kill_once(folder: Path, after_s: float) -> After:
    """Start a victim (on what the last one left), kill it after it has lived so long, and look."""
    victim = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.history_victim", str(folder)], stdout=subprocess.PIPE, text=True
    )
    assert victim.stdout is not None
    printed = [victim.stdout.readline()]
    timer = threading.Timer(after_s, victim.kill)
    timer.start()
    printed += list(victim.stdout)
    victim.wait()
    victim.stdout.close()
    timer.join()
    number, newest = next(line for line in reversed(printed) if line.endswith("\n")).split()
    return _look(folder / "flood", int(number), float(newest))


def _look(data: Path, last_event: int, newest: float) -> After:
    with sqlite3.connect(data / "lineside.db") as connection:
        connection.row_factory = sqlite3.Row
        there = connection.execute("SELECT count(*) FROM events WHERE id <= ?", (last_event,)).fetchone()[0]
        keys = open_keys([data / KEY_FILE], data / "lineside.db", heads_of(connection))
        intact = prove(connection, keys.ring, {}).broken is None
    tail = Tail()
    database = Database(data / "history.db", MIGRATIONS)
    Recorder(database, tail, lambda _: None).replay()
    folded = database.read_now(
        lambda connection: connection.execute("SELECT max(until) FROM bits").fetchone()[0]
    )
    stored = max((folded or 0, *(run[1] for _, run in tail.everything()))) / 1e6
    verdict = database.read_now(lambda connection: connection.execute("PRAGMA quick_check(1)").fetchone()[0])
    database.close()
    return After(last_event - there, max(0.0, newest - stored), intact and verdict == "ok")

"""A store of any size in seconds: blocks hold times relative to their start, so one is many."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

from app.core.database import Database
from app.line.history import tables
from app.line.history.series.runs import (
    DAY,
    HOUR,
    MINUTE,
    Run,
    combine,
    merge,
    pack_columns,
    pack_rollups,
    rollup,
)
from app.line.history.series.values import ParameterStep
from app.line.history.writer import MIGRATIONS
from bus.contract import Reading

POLL = 208_333
"""µs between two readings of one of eight units at 9600 baud."""
PATTERNS = 3
"""Different hours, one after the other."""


def readings(unit: int, start: float, seconds: float, seed: int = 0) -> Iterator[Reading]:
    """Yield the readings of one of eight units: the setpoint moves every half hour, the actual speed jitters,
    the poll interval varies a little.
    """
    chance = random.Random(seed + unit)
    actual = commanded = 12_000
    at, end = start, start + seconds
    while at < end:
        commanded = 12_000 + 200 * (int(at / 1800) % 5)
        actual += round((commanded - actual) / 20) + chance.randint(-1, 1)
        analog = 128 + chance.randint(-2, 2)
        outputs = 0xC0 if abs(actual - commanded) < 20 else 0x40
        yield Reading(unit, at, commanded, actual, analog, outputs, 0b11)
        at += POLL / 1e6 + chance.gauss(0, 0.0004)


def hour(seed: int) -> list[Run]:
    """One hour of one unit, from time 0."""
    runs = (
        Run(at, at, 1, r.commanded, r.actual, r.analog, r.outputs << 8 | r.inputs)
        for r in readings(1, 0, 3600, seed)
        for at in (round(r.at * 1e6),)
    )
    return merge((), runs)


def build(path: Path, bus: str, units: int, end: int, raw_days: int, days: int) -> int:
    """Write a store that ends at ``end`` (µs): readings of the last ``raw_days``, rollups of ``days``. Gives
    how many readings it holds."""
    database = Database(path, MIGRATIONS, synchronous="NORMAL")
    count = fill(database, (bus, units), end, raw_days=raw_days, days=days)
    database.close()
    return count


def fill(database: Database, line: tuple[str, int], end: int, *, raw_days: int, days: int) -> int:
    """Do so with a store of any engine; ``line``: the bus and how many units it has."""
    patterns = [hour(seed) for seed in range(PATTERNS)]
    end -= end % HOUR
    database.write_now(lambda connection: _fill(connection, patterns, line, end, (raw_days, days)))
    database.write_now(lambda connection: connection.execute("ANALYZE"))
    return line[1] * raw_days * 24 * sum(map(len, patterns)) // PATTERNS


def _fill(
    connection: tables.StoreConnection,
    patterns: list[list[Run]],
    line: tuple[str, int],
    end: int,
    days: tuple[int, int],
) -> None:
    blocks = [(len(runs), pack_columns(list(zip(*runs, strict=True)), 0)) for runs in patterns]
    minutes = [
        [rollup([r for r in runs if r.at // MINUTE == m], m * MINUTE) for m in range(60)] for runs in patterns
    ]
    packed = [pack_rollups(rows, 0) for rows in minutes]
    tables.unit_id(connection, line[0], 0)
    for number in range(1, line[1] + 1):
        unit = tables.unit_id(connection, line[0], number)
        tables.write_parameter(connection, unit, ParameterStep(end - days[1] * DAY, 3, 1))
        for start in range(end - days[0] * DAY, end, HOUR):
            _raw(connection, unit, start, blocks[start // HOUR % PATTERNS])
        for start in range(end - days[1] * DAY, end, HOUR):
            _row(connection, "minutes", unit, start, packed[start // HOUR % PATTERNS])
        for day in range((end - days[1] * DAY) // DAY * DAY, end, DAY):
            hours = [combine(minutes[h % PATTERNS], h * HOUR) for h in range(24)]
            _row(connection, "hours", unit, day, pack_rollups(hours, 0))


def _raw(connection: tables.StoreConnection, unit: int, start: int, block: tuple[int, bytes]) -> None:
    connection.execute(
        "INSERT INTO raw (unit, start, span, points, data) VALUES (?, ?, ?, ?, ?)",
        (unit, start, HOUR, *block),
    )


def _row(connection: tables.StoreConnection, tier: str, unit: int, start: int, data: bytes) -> None:
    connection.execute(f"INSERT INTO {tier} VALUES (?, ?, ?)", (unit, start, data))

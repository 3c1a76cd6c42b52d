"""From the journal into blocks: a minute that is over, and an hour that is over.

A minute that comes late takes the same way: its runs are merged with the stored ones, and the
minute, its hour and its bits are computed again from all of them.
"""

from __future__ import annotations

from collections.abc import Sequence

from app.history.series.intervals import splice
from app.history.series.rollup import combine, replace_row, rollup
from app.history.series.runs import DAY, HOUR, MINUTE, Run, merge
from app.history.store import tables


def fold(
    connection: tables.StoreConnection, unit: int, buses: Sequence[int], minute: int, runs: list[Run]
) -> None:
    """One minute of one unit into its block, its rollups and its bits. ``buses``: its port's key."""
    block = tables.raw_block(connection, unit, minute)
    start, span, known = block or (minute, MINUTE, [])
    everything = merge(known, runs)
    tables.write_raw(connection, unit, start, span, everything)
    of_minute = [run for run in everything if minute <= run.at < minute + MINUTE]
    _roll_up(connection, unit, minute, of_minute)
    _bits(connection, [unit, *buses], minute, of_minute)


def compact(connection: tables.StoreConnection, unit: int, hour: int) -> None:
    """The minutes of one unit and hour as one block: fewer rows, and better packed."""
    runs = merge((), tables.raw_minutes(connection, unit, hour))
    if runs:
        tables.write_raw(connection, unit, hour, HOUR, runs)


def _roll_up(connection: tables.StoreConnection, unit: int, minute: int, runs: Sequence[Run]) -> None:
    hour = minute - minute % HOUR
    minutes = tables.rollup_row(connection, "minutes", unit, hour)
    minutes = replace_row(minutes, rollup(runs, minute))
    tables.write_rollups(connection, "minutes", unit, hour, minutes)
    day = hour - hour % DAY
    hours = tables.rollup_row(connection, "hours", unit, day)
    tables.write_rollups(connection, "hours", unit, day, replace_row(hours, combine(minutes, hour)))


def _bits(connection: tables.StoreConnection, units: Sequence[int], minute: int, runs: Sequence[Run]) -> None:
    stored = tables.bits_around(connection, units[0], minute, minute + MINUTE)
    if not stored:
        since, until = minute, minute + MINUTE
    else:
        since, until = stored[0].at, max(stored[-1].until, minute + MINUTE)
    marks = tables.link_marks(connection, units, since, until)
    tables.replace_bits(connection, units[0], stored, splice(stored, minute, runs, marks))

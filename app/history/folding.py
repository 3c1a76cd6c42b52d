"""From the journal into blocks: a minute that is over, and an hour that is over.

A minute that comes late goes the same way: its runs are merged with what is there, and the
minute, its hour and its bits are worked out again from all of them.
"""

from __future__ import annotations

from collections.abc import Sequence

from app.history import store
from app.history.intervals import splice
from app.history.rollup import combine, replace_row, rollup
from app.history.runs import DAY, HOUR, MINUTE, Run, merge


def fold(connection: store.Connection, unit: int, buses: Sequence[int], minute: int, runs: list[Run]) -> None:
    """One minute of one unit into its block, its rollups and its bits. ``buses``: its port's key."""
    block = store.raw_block(connection, unit, minute)
    start, span, known = block or (minute, MINUTE, [])
    everything = merge(known, runs)
    store.write_raw(connection, unit, start, span, everything)
    of_minute = [run for run in everything if minute <= run.at < minute + MINUTE]
    _roll_up(connection, unit, minute, of_minute)
    _bits(connection, [unit, *buses], minute, of_minute)


def compact(connection: store.Connection, unit: int, hour: int) -> None:
    """The minutes of one unit and hour as one block: fewer rows, and better packed."""
    runs = merge((), store.raw_minutes(connection, unit, hour))
    if runs:
        store.write_raw(connection, unit, hour, HOUR, runs)


def _roll_up(connection: store.Connection, unit: int, minute: int, runs: Sequence[Run]) -> None:
    hour = minute - minute % HOUR
    minutes = store.rollup_row(connection, "minutes", unit, hour)
    minutes = replace_row(minutes, rollup(runs, minute))
    store.write_rollups(connection, "minutes", unit, hour, minutes)
    day = hour - hour % DAY
    hours = store.rollup_row(connection, "hours", unit, day)
    store.write_rollups(connection, "hours", unit, day, replace_row(hours, combine(minutes, hour)))


def _bits(connection: store.Connection, units: Sequence[int], minute: int, runs: Sequence[Run]) -> None:
    stored = store.bits_around(connection, units[0], minute, minute + MINUTE)
    if not stored:
        since, until = minute, minute + MINUTE
    else:
        since, until = stored[0].at, max(stored[-1].until, minute + MINUTE)
    marks = store.link_marks(connection, units, since, until)
    store.replace_bits(connection, units[0], stored, splice(stored, minute, runs, marks))

"""Packs minutes into blocks and bits, and the minutes of an hour that is over into one block with its
rollups.

A minute that comes late takes the same way: its runs are merged with the stored ones, and its bits, and the
rollups of a packed hour, are computed again from all of them. To fold a minute twice changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from app.history.intake.tail import Tail
from app.history.series.intervals import splice
from app.history.series.rollup import Rollup, combine, minute_rollups, replace_rows, rollup
from app.history.series.runs import DAY, HOUR, MINUTE, PlainRun, are_apart, merge_plain
from app.history.store import minutes, tables

MAX_AT_ONCE = 10_000
"""Runs folded in one transaction, about 50 ms: few enough that a slow machine still commits in time."""
MAX_KEYS = 64
"""Minutes of units folded in one transaction: each is a block and its bits."""
Minute = tuple[int, int]
"""The key of a unit and when the minute begins, µs."""
_Runs = Mapping[int, Sequence[PlainRun]]


def next_to_fold(folding: Iterable[Minute], tail: Tail) -> list[Minute]:
    """The first minutes, as many as are folded in one transaction."""
    keys: list[Minute] = []
    runs = 0
    for key in folding:
        keys.append(key)
        runs += tail.count(*key)
        if runs >= MAX_AT_ONCE or len(keys) == MAX_KEYS:
            break
    return keys


def fold_minutes(connection: tables.StoreConnection, tail: Tail, keys: Sequence[Minute]) -> None:
    """These minutes of a tail into their blocks, without what was given up for its age. Raises
    DamagedBlock."""
    given_up = tables.raw_from(connection)
    of_minute: dict[int, dict[int, list[PlainRun]]] = {}
    for unit, minute in keys:
        if minute + MINUTE > given_up and (runs := tail.minute(unit, minute)):
            of_minute.setdefault(minute, {})[unit] = runs
    for minute, by_unit in sorted(of_minute.items()):
        fold(connection, minute, by_unit)


def fold(connection: tables.StoreConnection, minute: int, by_unit: _Runs) -> None:
    """One minute of some units."""
    before = minutes.raw_blocks(connection, by_unit, minute)
    blocks: dict[int, minutes.RawBlock] = {}
    for unit, runs in by_unit.items():
        start, span, known = before.get(unit, (minute, MINUTE, ()))
        blocks[unit] = start, span, merge_plain(known, runs)
    minutes.write_raw_blocks(connection, blocks, before)
    complete = {
        unit: [run for run in runs if minute <= run[0] < minute + MINUTE]
        for unit, (_, _, runs) in blocks.items()
    }
    for unit, runs in complete.items():
        if blocks[unit][1] == HOUR:
            _roll_up(connection, unit, blocks[unit][0], [rollup(runs, minute)])
    _bits(connection, minute, complete)


def compact(connection: tables.StoreConnection, unit: int, hour: int) -> None:
    """The minutes of one unit and hour as one block, with its rollups: fewer rows, and better packed."""
    table: Sequence[Sequence[int]] = tables.raw_columns(connection, unit, hour, hour + HOUR)
    if table and not are_apart(table):
        table = list(zip(*merge_plain((), zip(*table, strict=True)), strict=True))
    if table:
        tables.write_raw(connection, unit, hour, HOUR, table)
        _roll_up(connection, unit, hour, minute_rollups(table))


def _roll_up(connection: tables.StoreConnection, unit: int, hour: int, rows: Sequence[Rollup]) -> None:
    """Minutes of an hour in place of those that are stored, and the hour in its day."""
    day = hour - hour % DAY
    of_hour = replace_rows(tables.rollups_of(connection, "minutes", unit, hour), rows)
    of_day = replace_rows(tables.rollups_of(connection, "hours", unit, day), [combine(of_hour, hour)])
    tables.write_rollups(connection, "minutes", unit, hour, of_hour)
    tables.write_rollups(connection, "hours", unit, day, of_day)


def _bits(connection: tables.StoreConnection, minute: int, by_unit: _Runs) -> None:
    end = minute + MINUTE
    stored = minutes.bits_around(connection, by_unit, minute, end)
    spans = {
        unit: (each[0].at, max(each[-1].until, end)) if each else (minute, end)
        for unit, each in stored.items()
    }
    marks = minutes.link_marks(connection, spans)
    spliced = {unit: splice(stored[unit], minute, runs, marks[unit]) for unit, runs in by_unit.items()}
    minutes.replace_bits(connection, stored, spliced)

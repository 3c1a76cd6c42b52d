"""Packs minutes into blocks and bits, and the minutes of an hour that is over into one block with rollups.

A minute that comes late takes the same way: its runs are merged with the stored ones, and its bits, and the
rollups of a packed hour, are computed again from all of them. To fold a minute twice changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from app.database.connection import upsert
from app.history import tables
from app.history.series.rollup import Rollup, combine, minute_rollups, replace_rows, rollup
from app.history.series.runs import DAY, HOUR, MINUTE, PlainRun, are_apart, merge_plain
from app.history.series.values import Interval, Marks, splice
from app.history.tables import INSERT_RAW, LOST_STATES, StoreConnection, block_runs, raw_row
from app.history.tail import Tail

_NONE = -1
"""The key of no unit."""
RawBlock = tuple[int, int, Sequence[PlainRun]]
"""Start and span in µs, and runs."""


def raw_blocks(connection: StoreConnection, units: Iterable[int], minute: int) -> dict[int, RawBlock]:
    """The block of each unit in which a minute falls, where there is one. Raises DamagedBlock."""
    keys = _filled(units)
    rows = connection.execute(
        f"SELECT unit, start, span, data FROM raw WHERE unit IN ({_list(keys)}) AND start IN (?, ?)"
        " ORDER BY start",
        (*keys, minute - minute % HOUR, minute),
    )
    return {
        unit: (start, span, block_runs(unit, start, data))
        for unit, start, span, data in rows
        if start + span > minute
    }


def write_raw_blocks(
    connection: StoreConnection, blocks: Mapping[int, RawBlock], before: Mapping[int, RawBlock]
) -> None:
    """Blocks by unit, in place of those that were there."""
    replaced = [(unit, block[0], block[1]) for unit, block in before.items()]
    if replaced:
        connection.executemany("DELETE FROM raw WHERE unit = ? AND start = ? AND span = ?", replaced)
    rows = [
        raw_row(unit, start, span, list(zip(*runs, strict=True)))
        for unit, (start, span, runs) in blocks.items()
    ]
    connection.executemany(INSERT_RAW, rows)


def bits_around(
    connection: StoreConnection, units: Iterable[int], start: int, end: int
) -> dict[int, list[Interval]]:
    """Of each unit the intervals that touch a span, and the neighbor on either side."""
    found: dict[int, list[Interval]] = {unit: [] for unit in units}
    keys = _filled(found)
    rows = connection.execute(
        f"WITH wanted (unit) AS (VALUES {_tuples(keys, 1)}), bounds AS MATERIALIZED ("
        "SELECT unit,"
        " coalesce((SELECT max(at) FROM bits WHERE bits.unit = wanted.unit AND at < ?), ?) AS low,"
        " coalesce((SELECT min(at) FROM bits WHERE bits.unit = wanted.unit AND at >= ?), ?) AS high"
        " FROM wanted) "
        "SELECT bits.unit, at, until, word FROM bounds"
        " JOIN bits ON bits.unit = bounds.unit AND at >= low AND at <= high ORDER BY bits.unit, at",
        (*keys, start, start, end, end),
    )
    for unit, *interval in rows:
        found[unit].append(Interval(*interval))
    return found


def link_marks(connection: StoreConnection, spans: Mapping[int, tuple[int, int]]) -> dict[int, Marks]:
    """When each unit or its port was lost and found within its span, µs."""
    keys = _filled(spans)
    values = [each for key in keys for each in (key, *spans.get(key, (0, 0)))]
    rows = connection.execute(
        f"WITH wanted (unit, since, until) AS (VALUES {_tuples(keys, 3)}) "
        "SELECT wanted.unit, link.at, link.state FROM wanted JOIN unit ON unit.id = wanted.unit"
        " JOIN unit AS marked ON marked.bus = unit.bus AND marked.number IN (0, unit.number)"
        " JOIN link ON link.unit = marked.id AND link.at >= wanted.since AND link.at <= wanted.until"
        " ORDER BY link.at",
        values,
    )
    marks: dict[int, tuple[list[int], list[int]]] = {}
    for unit, at, state in rows:
        marks.setdefault(unit, ([], []))[state not in LOST_STATES].append(at)
    return {unit: Marks(*marks.get(unit, ((), ()))) for unit in spans}


def replace_bits(
    connection: StoreConnection,
    old: Mapping[int, Sequence[Interval]],
    new: Mapping[int, Sequence[Interval]],
) -> None:
    """Replace intervals by unit; one that stays the same is not written."""
    gone = [(unit, part.at, part.word) for unit, part in _missing(old, new)]
    if gone:
        connection.executemany("DELETE FROM bits WHERE unit = ? AND at = ? AND word = ?", gone)
    added = [(unit, part.at, part.word, part.until) for unit, part in _missing(new, old)]
    connection.executemany(upsert("bits", ("unit", "at", "word"), ("until",)), added)


def _missing(
    parts: Mapping[int, Sequence[Interval]], there: Mapping[int, Sequence[Interval]]
) -> Iterable[tuple[int, Interval]]:
    return ((unit, part) for unit, each in parts.items() for part in sorted(set(each) - set(there[unit])))


def _filled(units: Iterable[int]) -> list[int]:
    keys = list(units)
    return keys + [_NONE] * ((1 << (len(keys) - 1).bit_length()) - len(keys))


def _list(keys: Sequence[int]) -> str:
    return ", ".join("?" * len(keys))


def _tuples(keys: Sequence[int], width: int) -> str:
    return ", ".join([f"({', '.join('?' * width)})"] * len(keys))


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
    before = raw_blocks(connection, by_unit, minute)
    blocks: dict[int, RawBlock] = {}
    for unit, runs in by_unit.items():
        start, span, known = before.get(unit, (minute, MINUTE, ()))
        blocks[unit] = start, span, merge_plain(known, runs)
    write_raw_blocks(connection, blocks, before)
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
    stored = bits_around(connection, by_unit, minute, end)
    spans = {
        unit: (each[0].at, max(each[-1].until, end)) if each else (minute, end)
        for unit, each in stored.items()
    }
    marks = link_marks(connection, spans)
    spliced = {unit: splice(stored[unit], minute, runs, marks[unit]) for unit, runs in by_unit.items()}
    replace_bits(connection, stored, spliced)

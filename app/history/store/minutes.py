"""The rows that the minutes of many units change: one statement each for all of them.

A statement to a database server costs more than its rows. Of a text with placeholders for a list there are
few variants: lists are filled up to a power of two.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from app.database.connection import upsert
from app.history.series.gaps import Marks
from app.history.series.intervals import Interval
from app.history.series.runs import HOUR, PlainRun
from app.history.store.tables import INSERT_RAW, LOST_STATES, StoreConnection, block_runs, raw_row

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

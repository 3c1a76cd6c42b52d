"""Readings as runs, and their summary by minutes and hours, as rollups.

A run is one response and how long the unit repeated it: the values, when they were first and last received,
and how often. Only the instants of equal readings in between are not kept. No run crosses a minute: the first
reading of every minute is a heartbeat, and a minute is complete without the others.

A rollup has the number of readings, and of each value the least, the greatest and the sum; of the bits, which
were ever off, which ever on, and how often each was on. Sums and counts are exact integers: an hour made of
minutes equals the hour made of readings.

Columns of integers are packed into few bytes, without loss. Each column becomes its differences, in the
narrowest width that holds them, byte plane by byte plane (all low bytes, then all next ones), which zlib
compresses. A constant column costs almost nothing; every step runs in C, so that a reading costs well under a
microsecond either way.
"""

from __future__ import annotations

import struct
import sys
import zlib
from array import array
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from functools import partial, reduce
from itertools import accumulate, chain
from operator import add, and_, gt, itemgetter, mul, or_, sub
from typing import NamedTuple

from bus.contract import Reading
from bus.instants import UnixTime

_HEAD = struct.Struct("<IB")
"""The head of a block: rows, then columns. One type code per column follows, then the planes."""
_CODES = "bhiq"
_SIZES = {code: array(code).itemsize for code in _CODES}
_LIMITS = {code: 1 << (8 * size - 1) for code, size in _SIZES.items()}
LEVEL = 6
"""The level of zlib: 9 saves less than 2 % and takes three times as long."""


def pack_integers(columns: Sequence[Sequence[int]], level: int = LEVEL) -> bytes:
    """Pack columns of equal length, with values within ±2^62. Raise OverflowError beyond."""
    rows = len(columns[0])
    codes, planes = [], []
    for column in columns:
        code, plane = _planes(column)
        codes.append(code)
        planes.append(plane)
    head = _HEAD.pack(rows, len(columns)) + "".join(codes).encode("ascii")
    return zlib.compress(head + b"".join(planes), level)


def unpack_integers(
    blob: bytes, wanted: Iterable[int] | None = None, within: tuple[int, int] | None = None
) -> list[list[int]]:
    """Return all columns, or the ``wanted`` ones by position. ``within``: only the rows whose value in the
    first column, which then has to rise, is at least the first number and below the second. Raise ValueError
    for damaged bytes."""
    try:
        data = zlib.decompress(blob)
        rows, count = _HEAD.unpack_from(data)
        codes = data[_HEAD.size : _HEAD.size + count].decode("ascii")
        sizes = [rows * _SIZES[code] for code in codes]
    except (zlib.error, struct.error, ValueError, KeyError) as error:
        raise ValueError(f"a block of history is damaged: {error}") from error
    starts = list(accumulate(sizes, initial=_HEAD.size + count))
    if starts[-1] != len(data):
        raise ValueError("a block of history is damaged: its length is wrong")
    positions = range(count) if wanted is None else wanted
    part = slice(0, rows)
    if within is not None:
        first = _column(data[starts[0] : starts[1]], codes[0], rows, part)
        part = slice(*(bisect_left(first, edge) for edge in within))
    return [_column(data[starts[i] : starts[i + 1]], codes[i], rows, part) for i in positions]


def _planes(column: Sequence[int]) -> tuple[str, bytes]:
    if column and column.count(column[0]) == len(column):
        return _steady(column[0], len(column))
    differences = [*column[:1], *map(sub, column[1:], column)]
    code = _narrowest(differences)
    packed = array(code, differences)
    _little(packed)
    data = packed.tobytes()
    size = packed.itemsize
    return code, data if size == 1 else b"".join([data[i::size] for i in range(size)])


def _steady(value: int, rows: int) -> tuple[str, bytes]:
    """Pack a column of the same value in every row: its difference to 0, then none."""
    code, rest = _narrowest((value,)), bytes(rows - 1)
    first = value.to_bytes(_SIZES[code], "little", signed=True)
    return code, b"".join([first[i : i + 1] + rest for i in range(len(first))])


def _narrowest(values: Sequence[int]) -> str:
    if not values:
        return _CODES[0]
    reach = max(max(values), -min(values) - 1)
    for code, limit in _LIMITS.items():
        if reach < limit:
            return code
    return _CODES[-1]


def _column(planes: bytes | bytearray, code: str, rows: int, part: slice) -> list[int]:
    """Return the values of the rows ``part`` of a column."""
    if len(planes) == rows and not planes[1:].strip(b"\0"):
        return [*array(code, planes[:1])] * (part.stop - part.start)
    column = array(code)
    if column.itemsize > 1:
        data = bytearray(len(planes))
        for i in range(column.itemsize):
            data[i :: column.itemsize] = planes[i * rows : (i + 1) * rows]
        planes = data
    column.frombytes(planes)
    _little(column)
    if part.start == part.stop:
        return []
    return list(accumulate(column[part.start + 1 : part.stop], initial=sum(column[: part.start + 1])))


def _little(values: array[int]) -> None:
    if sys.byteorder == "big":
        values.byteswap()


SECOND = 1_000_000
MINUTE = 60 * SECOND
HOUR = 60 * MINUTE
DAY = 24 * HOUR


class Run(NamedTuple):
    """Equal consecutive readings. Times are in µs since the epoch, values as on the wire."""

    at: int
    until: int
    readings: int
    """The number of readings."""
    commanded: int
    actual: int
    analog: int
    word: int
    """ST2 * 256 + ST1: all output and input bits."""


PlainRun = tuple[int, int, int, int, int, int, int]
"""A run as a plain tuple, which the garbage collector stops visiting."""
_named: Callable[[PlainRun], Run] = partial(tuple.__new__, Run)
_AT, _UNTIL = itemgetter(0), itemgetter(1)
COLUMNS = {name: position for position, name in enumerate(Run._fields)}


def micros(at: UnixTime) -> int:
    """Convert seconds since the epoch to integer µs."""
    return round(float(at) * SECOND)


def plain_run(reading: Reading) -> PlainRun:
    """Return a run of one reading, which must have plausible speeds."""
    assert reading.commanded is not None
    assert reading.actual is not None
    at = round(float(reading.at) * SECOND)
    word = reading.outputs << 8 | reading.inputs
    return at, at, 1, reading.commanded, reading.actual, reading.analog, word


def runs_of(plain: Iterable[PlainRun]) -> list[Run]:
    """Return plain runs with named fields."""
    return list(map(_named, plain))


def follows(run: PlainRun, last: PlainRun) -> bool:
    """Return whether ``run`` repeats ``last`` later in the same minute."""
    return run[3:] == last[3:] and run[0] >= last[1] and run[1] // MINUTE == last[0] // MINUTE


def joined(last: PlainRun, run: PlainRun) -> PlainRun:
    """Join two runs, the second following the first."""
    return (last[0], run[1], last[2] + run[2], *last[3:])


def merge(one: Iterable[PlainRun], other: Iterable[PlainRun]) -> list[Run]:
    """Merge runs in order of time. A run of both is there once, and no value is lost."""
    return runs_of(merge_plain(one, other))


def merge_plain(one: Iterable[PlainRun], other: Iterable[PlainRun]) -> list[PlainRun]:
    """Merge plain runs in order of time; a run of both is there once."""
    runs = sorted(chain(one, other))
    if all(map(gt, map(_AT, runs[1:]), map(_UNTIL, runs))):
        return runs
    merged: list[PlainRun] = []
    last: PlainRun | None = None
    for run in runs:
        if last is None or run[0] > last[1] or run[3:] != last[3:]:
            merged.append(run)
        else:
            merged[-1] = (last[0], max(last[1], run[1]), max(last[2], run[2]), *last[3:])
        last = merged[-1]
    return merged


def pack_columns(table: Sequence[Sequence[int]], start: int) -> bytes:
    """Pack the columns of runs of one unit as a block that starts at ``start``, µs."""
    at, until, *rest = table
    return pack_integers([[t - start for t in at], list(map(sub, until, at)), *rest])


def unpack_runs(blob: bytes, start: int) -> list[Run]:
    """Unpack the runs of a block. Raise ValueError if it is damaged."""
    return runs_of(zip(*unpack_columns(blob, start, Run._fields), strict=True))


def unpack_columns(
    blob: bytes, start: int, names: Sequence[str], within: tuple[int, int] | None = None
) -> list[list[int]]:
    """Unpack some columns of a block; ``until`` needs ``at``. ``within``: only the runs that begin between
    two times, µs. Raise ValueError if it is damaged."""
    part = None if within is None else (within[0] - start, within[1] - start)
    found = unpack_integers(blob, [COLUMNS[name] for name in names], part)
    by_name = dict(zip(names, found, strict=True))
    if "at" in by_name:
        by_name["at"] = list(map(start.__add__, by_name["at"]))
    if "until" in by_name:
        lengths = by_name["until"]
        by_name["until"] = list(map(add, by_name["at"], lengths) if any(lengths) else by_name["at"])
    return [by_name[name] for name in names]


BITS = 16
"""ST2 * 256 + ST1, as in :class:`app.line.history.series.runs.Run`."""


class Rollup(NamedTuple):
    """The summary of a minute or an hour of one unit. ``start`` is in µs, values are as on the wire."""

    start: int
    readings: int
    commanded_min: int
    commanded_max: int
    commanded_sum: int
    actual_min: int
    actual_max: int
    actual_sum: int
    analog_min: int
    analog_max: int
    analog_sum: int
    word_and: int
    """The bits that were on in every reading."""
    word_or: int
    """The bits that were on in any reading."""
    on: tuple[int, ...]
    """The number of readings in which each bit was on."""


_PLAIN = len(Rollup._fields) - 1
FIELDS = {name: position for position, name in enumerate(Rollup._fields[:-1])} | {
    f"on_{bit}": _PLAIN + bit for bit in range(BITS)
}
"""Position of each column in a packed row of rollups."""


def rollup(runs: Sequence[PlainRun], start: int) -> Rollup:
    """Summarize the runs of a minute or an hour of one unit, at least one."""
    return _rollup(list(zip(*runs, strict=True)), start)


def minute_rollups(table: Sequence[Sequence[int]]) -> list[Rollup]:
    """Summarize each minute of the columns of runs, in order of time."""
    at, rows, first = table[0], [], 0
    while first < len(at):
        minute = at[first] - at[first] % MINUTE
        last = bisect_left(at, minute + MINUTE, first)
        rows.append(_rollup([column[first:last] for column in table], minute))
        first = last
    return rows


def _rollup(table: Sequence[Sequence[int]], start: int) -> Rollup:
    _, _, counts, commanded, actual, analog, words = table
    weights = {words[0]: sum(counts)}
    if words.count(words[0]) < len(words):
        weights = dict.fromkeys(words, 0)
        for word, count in zip(words, counts, strict=True):
            weights[word] += count
    return Rollup(
        start,
        sum(counts),
        *_reach(commanded, counts),
        *_reach(actual, counts),
        *_reach(analog, counts),
        reduce(and_, weights),
        reduce(or_, weights),
        _counts(weights.items()),
    )


def _reach(values: Sequence[int], counts: Sequence[int]) -> tuple[int, int, int]:
    return min(values), max(values), sum(map(mul, values, counts))


def _counts(words: Iterable[tuple[int, int]]) -> tuple[int, ...]:
    """Return the number of readings with each bit, from words and the number of their readings."""
    on = [0] * BITS
    for word, count in words:
        for bit in range(BITS):
            if word >> bit & 1:
                on[bit] += count
    return tuple(on)


def combine(rows: Sequence[Rollup], start: int) -> Rollup:
    """Combine rollups, at least one, into one of a longer time."""
    _, readings, *plain, words_and, words_or, on = zip(*rows, strict=True)
    reaches = [
        reach
        for least, greatest, total in zip(plain[0::3], plain[1::3], plain[2::3], strict=True)
        for reach in (min(least), max(greatest), sum(total))
    ]
    bits = tuple(sum(column) for column in zip(*on, strict=True))
    words = reduce(and_, words_and), reduce(or_, words_or)
    return Rollup._make([start, sum(readings), *reaches, *words, bits])


def pack_rollups(rows: Sequence[Rollup], start: int) -> bytes:
    """Pack rollups of one unit, in order of time, as a block that starts at ``start``, µs."""
    starts, *plain, on = zip(*rows, strict=True)
    return pack_integers([[t - start for t in starts], *plain, *zip(*on, strict=True)])


def unpack_rollups(blob: bytes, start: int) -> list[Rollup]:
    """Unpack the rollups of a block. Raise ValueError if it is damaged."""
    rows = zip(*unpack_integers(blob), strict=True)
    return [Rollup._make([start + row[0], *row[1:_PLAIN], row[_PLAIN:]]) for row in rows]


def replace_rows(rows: Iterable[Rollup], newer: Iterable[Rollup]) -> list[Rollup]:
    """Replace rows that start with one of ``newer``, and add the other newer ones, in order of time."""
    by_start = {row.start: row for each in (rows, newer) for row in each}
    return sorted(by_start.values())

"""Readings as runs: one response, and how long the unit repeated it.

A run holds everything the unit sent: the values, when they were first and last received
and how often. Only the instants of equal readings in between are not kept. No run crosses a
minute: the first reading of every minute is a heartbeat, and a minute is complete without the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import chain
from operator import add, gt, itemgetter, sub
from typing import NamedTuple

from app.line.history.series import columns
from bus.contract import Reading
from bus.instants import UnixTime

SECOND = 1_000_000
MINUTE = 60 * SECOND
HOUR = 60 * MINUTE
DAY = 24 * HOUR


class Run(NamedTuple):
    """Equal readings one after the other. Times in µs since the epoch, values as on the wire."""

    at: int
    until: int
    readings: int
    """How many readings these are."""
    commanded: int
    actual: int
    analog: int
    word: int
    """ST2 * 256 + ST1: all output and input bits."""


PlainRun = tuple[int, int, int, int, int, int, int]
"""A run as a plain tuple: of hundreds of thousands in memory the garbage collector looks at none."""
_named: Callable[[PlainRun], Run] = partial(tuple.__new__, Run)
_AT, _UNTIL = itemgetter(0), itemgetter(1)
COLUMNS = {name: position for position, name in enumerate(Run._fields)}


def micros(at: UnixTime) -> int:
    """Convert seconds since the epoch to integer µs."""
    return round(float(at) * SECOND)


def plain_run(reading: Reading) -> PlainRun:
    """A reading as a run of one; one with an implausible speed is not stored."""
    assert reading.commanded is not None
    assert reading.actual is not None
    at = round(float(reading.at) * SECOND)
    word = reading.outputs << 8 | reading.inputs
    return at, at, 1, reading.commanded, reading.actual, reading.analog, word


def runs_of(plain: Iterable[PlainRun]) -> list[Run]:
    """Plain runs with their names."""
    return list(map(_named, plain))


def follows(run: PlainRun, last: PlainRun) -> bool:
    """Whether ``run`` repeats ``last`` later in the same minute."""
    return run[3:] == last[3:] and run[0] >= last[1] and run[1] // MINUTE == last[0] // MINUTE


def joined(last: PlainRun, run: PlainRun) -> PlainRun:
    """Join two runs, the second following the first."""
    return (last[0], run[1], last[2] + run[2], *last[3:])


def merge(one: Iterable[PlainRun], other: Iterable[PlainRun]) -> list[Run]:
    """Merge runs in order of time; what both hold is there once. No value that either holds is lost."""
    return runs_of(merge_plain(one, other))


def merge_plain(one: Iterable[PlainRun], other: Iterable[PlainRun]) -> list[PlainRun]:
    """Merge plain runs in order of time; a run that both hold is there once."""
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
    """Pack the columns of runs of one unit as a block; times are kept relative to ``start``, in µs."""
    at, until, *rest = table
    return columns.pack([[t - start for t in at], list(map(sub, until, at)), *rest])


def are_apart(table: Sequence[Sequence[int]]) -> bool:
    """Whether columns of runs are in order of time and none touches the next, so that none is merged."""
    at, until, *_ = table
    return all(map(gt, at[1:], until))


def unpack_runs(blob: bytes, start: int) -> list[Run]:
    """The runs of a block. Raises ValueError when it is damaged."""
    return runs_of(zip(*unpack_columns(blob, start, Run._fields), strict=True))


def unpack_columns(blob: bytes, start: int, names: Sequence[str]) -> list[list[int]]:
    """Some columns of a block: ``at`` is needed for ``until``."""
    found = columns.unpack(blob, [COLUMNS[name] for name in names])
    by_name = dict(zip(names, found, strict=True))
    if "at" in by_name:
        by_name["at"] = [t + start for t in by_name["at"]]
    if "until" in by_name:
        by_name["until"] = list(map(add, by_name["at"], by_name["until"]))
    return [by_name[name] for name in names]

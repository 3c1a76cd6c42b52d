"""Readings as runs: one response, and how long the unit repeated it.

A run holds everything the unit sent: the values, when they were first and last received
and how often. Only the instants of equal readings in between are not kept. No run crosses a
minute: the first reading of every minute is a heartbeat, and a minute is complete without the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain
from operator import add
from typing import NamedTuple

from app.history.series import columns
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


COLUMNS = {name: position for position, name in enumerate(Run._fields)}


def micros(at: UnixTime) -> int:
    """Convert seconds since the epoch to integer µs."""
    return round(float(at) * SECOND)


def run_of(reading: Reading) -> Run:
    at = micros(reading.at)
    word = reading.outputs << 8 | reading.inputs
    return Run(at, at, 1, reading.commanded, reading.actual, reading.analog, word)


def follows(run: Run, last: Run) -> bool:
    """Whether ``run`` repeats ``last`` later in the same minute."""
    return run[3:] == last[3:] and run.at >= last.until and run.until // MINUTE == last.at // MINUTE


def joined(last: Run, run: Run) -> Run:
    """One run of two, the second following the first."""
    return last._replace(until=run.until, readings=last.readings + run.readings)


def merge(one: Iterable[Run], other: Iterable[Run]) -> list[Run]:
    """Both in order of time; what both hold is there once. No value that either holds is lost."""
    merged: list[Run] = []
    for run in sorted(chain(one, other)):
        last = merged[-1] if merged else None
        if last is None or run[3:] != last[3:] or run.at > last.until:
            merged.append(run)
        else:
            merged[-1] = last._replace(
                until=max(last.until, run.until), readings=max(last.readings, run.readings)
            )
    return merged


def pack_runs(runs: Sequence[Run], start: int) -> bytes:
    """Runs of one unit as a block; times are kept relative to ``start``, in µs."""
    at, until, *rest = zip(*runs, strict=True)
    return columns.pack([[t - start for t in at], [b - a for a, b in zip(at, until, strict=True)], *rest])


def unpack_runs(blob: bytes, start: int) -> list[Run]:
    """The runs of a block. Raises ValueError when it is damaged."""
    return [Run(*row) for row in zip(*unpack_columns(blob, start, Run._fields), strict=True)]


def unpack_columns(blob: bytes, start: int, names: Sequence[str]) -> list[list[int]]:
    """Some columns of a block: ``at`` is needed for ``until``."""
    found = columns.unpack(blob, [COLUMNS[name] for name in names])
    by_name = dict(zip(names, found, strict=True))
    if "at" in by_name:
        by_name["at"] = [t + start for t in by_name["at"]]
    if "until" in by_name:
        by_name["until"] = list(map(add, by_name["at"], by_name["until"]))
    return [by_name[name] for name in names]

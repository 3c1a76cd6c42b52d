"""The readings in memory of minutes that are not over yet; the journal on disk holds the same.

One thread adds and drops, any thread reads.
"""

from __future__ import annotations

import struct
import threading
from array import array
from bisect import bisect_right, insort
from collections.abc import Container, Iterable

from app.line.history.series.runs import MINUTE, SECOND, PlainRun, Run, follows, joined, runs_of

WIDTH = len(Run._fields)
_BYTES = struct.Struct(f"{WIDTH}q").pack
"""Packs a run faster than `array.extend` takes a tuple."""
_UNTIL = Run._fields.index("until")
_ACTUAL = Run._fields.index("actual") - WIDTH
BREAK = 2 * SECOND
"""Equal readings further apart than this do not make one run: there may be a hole between."""


def _last(runs: array[int]) -> PlainRun:
    at, until, readings, commanded, actual, analog, word = runs[-WIDTH:]
    return at, until, readings, commanded, actual, analog, word


def _plain(runs: Iterable[int]) -> list[PlainRun]:
    return list(zip(*[iter(runs)] * WIDTH, strict=True))


def _by_time(key: tuple[int, int]) -> tuple[int, int]:
    return key[1], key[0]


class Tail:
    """Runs by unit and minute, in order of arrival. Their fields stand one after the other in an array, as
    the garbage collector would visit half a million tuples every few seconds."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._minutes: dict[tuple[int, int], array[int]] = {}
        self._lost: dict[int, list[int]] = {}
        """The times at which each unit stopped responding (µs), in order."""

    def add(self, rows: Iterable[tuple[int, PlainRun]]) -> None:
        """Add readings or runs of units, in order of arrival."""
        with self._lock:
            for unit, run in rows:
                self._add_one(unit, run)

    def _add_one(self, unit: int, run: PlainRun) -> None:
        key = unit, run[0] - run[0] % MINUTE
        runs = self._minutes.get(key)
        if runs is None:
            self._minutes[key] = array("q", run)
            return
        # The actual speed first: it differs most often.
        if runs[_ACTUAL] == run[_ACTUAL]:
            last = _last(runs)
            if follows(run, last) and not self._broken(unit, last[1], run[0]):
                del runs[-WIDTH:]
                run = joined(last, run)
        runs.frombytes(_BYTES(*run))

    def _broken(self, unit: int, since: int, until: int) -> bool:
        if until - since > BREAK:
            return True
        lost = self._lost.get(unit, ())
        place = bisect_right(lost, since)
        return place < len(lost) and lost[place] <= until

    def mark_lost(self, lost: Iterable[tuple[int, int]]) -> None:
        """Note when units stopped responding (µs), which no run crosses. Call it before the readings that
        follow are added."""
        with self._lock:
            for unit, at in lost:
                insort(self._lost.setdefault(unit, []), at)

    def interrupt(self) -> None:
        """Let the next reading of every unit begin a new run, as nothing was recorded until now."""
        self.mark_lost({(unit, run[1] + 1) for unit, run in self.everything()})

    def runs(self, unit: int, start: int, end: int) -> list[Run]:
        """Return a unit's runs that touch a span (µs), in order of time."""
        with self._lock:
            found = [
                run
                for (owner, minute), runs in self._minutes.items()
                if owner == unit and minute < end and minute + MINUTE > start
                for run in _plain(runs)
            ]
        return runs_of(sorted(run for run in found if run[0] < end and run[1] >= start))

    def since(self, after: int) -> dict[int, list[PlainRun]]:
        """Return the last runs of each unit that reach a time, µs, in order of arrival, at the cost of these
        runs."""
        found: dict[int, list[PlainRun]] = {}
        with self._lock:
            for (unit, minute), runs in self._minutes.items():
                place = len(runs) if minute + MINUTE > after else 0
                while place and runs[place - WIDTH + _UNTIL] >= after:
                    place -= WIDTH
                if place < len(runs) and minute + MINUTE > after:
                    found.setdefault(unit, []).extend(_plain(runs[place:]))
        return found

    def minute(self, unit: int, minute: int) -> list[PlainRun]:
        """Return all runs of one unit in one minute."""
        with self._lock:
            return _plain(self._minutes.get((unit, minute), ()))

    def count(self, unit: int, minute: int) -> int:
        """Count the runs of one unit in one minute."""
        with self._lock:
            return len(self._minutes.get((unit, minute), ())) // WIDTH

    def over(self, current: int) -> list[tuple[int, int]]:
        """Return the units and minutes except the current one, which is still growing, the oldest first."""
        with self._lock:
            return sorted((key for key in self._minutes if key[1] != current), key=_by_time)

    def extent(self) -> tuple[int, int] | None:
        """Return the span of all minutes, µs; None if there are none."""
        with self._lock:
            minutes = [minute for _, minute in self._minutes]
        return (min(minutes), max(minutes) + MINUTE) if minutes else None

    def drop(self, unit: int, minute: int) -> None:
        """Forget the runs of a minute that is stored in a block."""
        with self._lock:
            self._minutes.pop((unit, minute), None)
            if unit in self._lost:
                self._lost[unit] = [at for at in self._lost[unit] if at >= minute]

    def clear(self) -> None:
        """Forget everything, before the journal is read again."""
        with self._lock:
            self._minutes.clear()
            self._lost.clear()

    def everything(self, without: Container[tuple[int, int]] = ()) -> list[tuple[int, PlainRun]]:
        """Return each run with its unit, except those of the units and minutes in ``without``."""
        with self._lock:
            minutes = sorted(key for key in self._minutes if key not in without)
            return [(key[0], run) for key in minutes for run in _plain(self._minutes[key])]

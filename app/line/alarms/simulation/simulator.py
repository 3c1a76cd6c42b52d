"""Runs simulations: one at a time, each within its bounds, in pieces that leave time for everything else."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from itertools import groupby

from app.core.server.admission.fair_queue import FairQueue
from app.line.alarms.own.definition import in_toml
from app.line.alarms.settings import AlarmSettings
from app.line.alarms.simulation.replay import (
    AlarmSimulation,
    Annunciations,
    AtRest,
    Replay,
    ZeroStep,
    rest_of,
)
from app.line.history import tables, unit_history
from app.line.history.series.runs import HOUR, MINUTE, SECOND, Run, micros
from app.line.history.series.values import VALUES, ParameterStep
from app.line.history.service import History
from app.line.history.tail import Tail
from app.line.history.unit_history import StoredUnit, minutes_of
from bus.instants import UnixTime
from bus.settings import BusSettings

MAX_WAITING = 3
"""Simulations of one account that wait for their turn."""
WORK_S = 10.0
"""CPU time of a thread that one simulation may take."""


class Simulator:
    """Simulates alarms of all buses. ``work_s``: CPU time that one simulation may take."""

    def __init__(self, history: History, work_s: float = WORK_S) -> None:
        self._history = history
        self._work_s = work_s
        self._turns: FairQueue[str] = FairQueue(1, 1, MAX_WAITING)

    async def run(
        self, bus: BusSettings, settings: AlarmSettings, start: UnixTime, end: UnixTime, account: str
    ) -> AlarmSimulation:
        """What an alarm would have done from ``start`` to ``end``. Raises StoreError where history cannot be
        read, TooManyWaitingError where too many simulations of the account wait."""
        async with self._turns.turn(account):
            return await self._run(bus, settings, start, end)

    async def _run(
        self, bus: BusSettings, settings: AlarmSettings, start: UnixTime, end: UnixTime
    ) -> AlarmSimulation:
        begins, steps = await self._history.read(
            lambda connection, tail: _extent(connection, tail, bus.name, settings.unit), costly=True
        )
        if begins is None or begins >= micros(end):
            return _outcome(settings, (start, end), Annunciations())
        since = max(micros(start), begins)
        covered_from = UnixTime(since / SECOND)
        since -= since % MINUTE
        replay, spent = Replay(bus, settings, steps, covered_from, end), 0.0
        while since < micros(end) and spent < self._work_s:
            until = min(since - since % HOUR + HOUR, micros(end) + MINUTE - micros(end) % MINUTE)
            took = await self._history.read(
                lambda connection, tail, a=since, b=until: _feed(  # type: ignore[misc]
                    StoredHour(connection, tail, bus, a, b), replay, settings
                ),
                costly=True,
            )
            spent += took
            # As long as it took: what others do comes first.
            await asyncio.sleep(took)
            since = until
        reached = max(covered_from, UnixTime(min(since, micros(end)) / SECOND))
        replay.end(reached)
        covered, is_complete = (covered_from, reached), micros(reached) >= micros(end)
        return _outcome(settings, (start, end), replay.found, covered, replay.unknown_s, is_complete)


def _extent(
    connection: tables.StoreConnection, tail: Tail, bus: str, unit: int
) -> tuple[int | None, Sequence[ParameterStep]]:
    """From when on the readings of a unit are stored (µs; None: there are none), and its parameters that
    scale."""
    key = tables.find_unit(connection, bus, unit)
    if key is None:
        return None, ()
    source = StoredUnit(connection, key, tail.runs(key, 0, 2**62)[:1])
    starts = [run.at for run in source.tail]
    first = tables.first_minute(connection, key)
    if first is not None:
        starts += [min((row.start for row in minutes_of(source, first, first + HOUR)), default=first)]
    begins = max(min(starts), tables.raw_from(connection)) if starts else None
    return begins, tables.parameter_steps(connection, key)


def _feed(hour: StoredHour, replay: Replay, settings: AlarmSettings) -> float:
    """Feed an hour to a simulation, and return the CPU seconds of this thread that it took."""
    begun = time.thread_time()
    hour.feed(replay, settings)
    return time.thread_time() - begun


def _outcome(
    settings: AlarmSettings,
    span: tuple[UnixTime, UnixTime],
    found: Annunciations,
    covered: tuple[UnixTime | None, UnixTime | None] = (None, None),
    unknown_s: float = 0.0,
    is_complete: bool = True,
) -> AlarmSimulation:
    stands_at_end = found.stands_since is not None
    if covered[1] is not None:
        found.end(covered[1])
    return AlarmSimulation(
        *span,
        *covered,
        annunciated=len(found.at),
        chattering=found.chattering,
        first=found.at[0] if found.at else None,
        last=found.at[-1] if found.at else None,
        standing_s=round(sum(found.lengths), 3),
        longest_s=round(max(found.lengths), 3) if found.lengths else None,
        stands_at_end=stands_at_end,
        unknown_s=round(unknown_s, 3),
        complete=is_complete,
        toml=in_toml(settings),
    )


class StoredHour:
    """Feeds one hour of a unit from the store, on one connection. ``start`` and ``end``: complete minutes,
    µs."""

    def __init__(
        self, connection: tables.StoreConnection, tail: Tail, bus: BusSettings, start: int, end: int
    ) -> None:
        self._connection = connection
        self._tail = tail
        self._bus = bus
        self._start, self._end = start, end
        self._rest: AtRest | None = None
        self._runs: dict[int, list[Run]] | None = None

    def feed(self, replay: Replay, settings: AlarmSettings) -> None:
        """Let ``replay`` see every minute that is stored."""
        source = self._source(settings.unit)
        if source is None:
            return
        rows = {row.start: row for row in minutes_of(source, self._start, self._end)}
        for minute in range(self._start, self._end, MINUTE):
            if minute in rows and replay.passes(rows[minute]):
                continue
            for run in self._runs_of(source).get(minute, ()):
                replay.see_run(run, self._is_at_rest)

    def _source(self, unit: int) -> StoredUnit | None:
        span = (self._start, self._end)
        return unit_history.stored_unit(self._connection, self._tail, self._bus.name, unit, *span)

    def _runs_of(self, source: StoredUnit) -> dict[int, list[Run]]:
        if self._runs is None:
            found = unit_history.runs_between(source, self._start, self._end)
            self._runs = {
                minute: list(runs) for minute, runs in groupby(found, lambda run: run.at - run.at % MINUTE)
            }
        return self._runs

    def _is_at_rest(self, at: int) -> bool:
        if self._rest is None:
            self._rest = rest_of([self._zero_steps(unit.id) for unit in self._bus.unit])
        return self._rest(at)

    def _zero_steps(self, unit: int) -> list[ZeroStep]:
        """By the minute, where in each minute either zero or another speed was commanded all the time."""
        source = self._source(unit)
        if source is None:
            return []
        rows = list(minutes_of(source, self._start, self._end))
        is_mixed = any(row.commanded_min == 0 < row.commanded_max for row in rows)
        if not source.tail and not is_mixed:
            return [(row.start, row.commanded_max == 0) for row in rows]
        found = unit_history.readings(source, VALUES["commanded"], self._start, self._end)
        return [(at, value == 0) for at, value in zip(found.at, found.least, strict=True)]

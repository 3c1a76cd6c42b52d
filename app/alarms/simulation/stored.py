"""Feeds a simulation from the store, an hour at a time."""

from __future__ import annotations

from itertools import groupby

from app.alarms.settings import AlarmSettings
from app.alarms.simulation.replay import Replay
from app.alarms.simulation.rest import AtRest, ZeroStep, rest_of
from app.history import tables, unit_history
from app.history.series.runs import MINUTE, Run
from app.history.series.values import VALUES
from app.history.tail import Tail
from app.history.unit_history import StoredUnit, minutes_of
from bus.settings import BusSettings


class StoredHour:
    """One hour of a unit, on one connection. ``start`` and ``end`` in µs, complete minutes."""

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

"""The run time of a unit over a span, from the store alone."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain

from app.history.intake.tail import Tail
from app.history.query.query import SeriesQuery, has_raw, scale_of
from app.history.query.unit_history import minutes_of, runs_between, stored_unit
from app.history.series.run_time import RunFigures, run_figures, runs_of_minutes
from app.history.series.runs import MINUTE
from app.history.series.scaling import ParameterStep
from app.history.series.values import VALUES
from app.history.store import tables
from bus.catalogue.numbers import FOLLOWER_MODE
from bus.settings import BusSettings


def stored_tail(connection: tables.StoreConnection) -> Tail:
    """The readings of minutes that are not over, as a server would load them; nothing is changed."""
    tail = Tail()
    for rows in chain(tables.read_journal(connection), tables.read_other_journals(connection, 0)):
        tail.add(rows or ())
    return tail


def unit_figures(
    connection: tables.StoreConnection, tail: Tail, bus: BusSettings, unit: int, start: int, end: int
) -> RunFigures | None:
    """The figures of a unit over a span, µs; from minutes where the readings are no longer kept. None for a
    follower whose speeds are ratios, which do not show whether it runs."""
    source = stored_unit(connection, tail, bus.name, unit, start - MINUTE, end)
    if source is None:
        return RunFigures()
    if bus.follower_speed == "ratio" and _was_follower(tables.parameter_steps(connection, source.unit), end):
        return None
    scales = scale_of(source, SeriesQuery(bus, unit, VALUES["actual"], start, end, 1))
    by_minute = not has_raw(connection, source.unit, start)
    runs = (
        runs_of_minutes(minutes_of(source, start - MINUTE, end))
        if by_minute
        else runs_between(source, start - MINUTE, end)
    )
    figures = run_figures(runs, start, end, bus.estop_healthy, lambda at, raw: scales.at(at).apply(raw))
    figures.by_minute = by_minute
    return figures


def _was_follower(steps: Iterable[ParameterStep], end: int) -> bool:
    modes = [step for step in sorted(steps) if step.number == FOLLOWER_MODE and step.at < end]
    return bool(modes and modes[-1].raw)

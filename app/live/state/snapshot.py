"""A worker's complete state as the updates that lead to it. Pure."""

from __future__ import annotations

from bus.contract import Snapshot, Staged, UnitState, Update
from bus.instants import UnixTime


def updates_of(snapshot: Snapshot) -> list[Update]:
    """A complete state as the updates that lead to it."""
    updates: list[Update] = [snapshot.bus]
    for unit in snapshot.units:
        updates += _updates_of_unit(unit, snapshot.sent_at)
    if snapshot.figures is not None:
        updates.append(snapshot.figures)
    return updates


def _updates_of_unit(state: UnitState, at: UnixTime) -> list[Update]:
    updates: list[Update] = [state.link]
    if state.reading is not None:
        updates.append(state.reading)
    updates += state.parameters
    updates.append(Staged(unit=state.unit, at=at, raw=state.staged))
    return updates

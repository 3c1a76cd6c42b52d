"""The present state of every bus and unit. It has one writer: what the workers report.

A command never changes it. Times are seconds since the epoch on the app's own clock; the feed
shifts a worker's times before they come here. What is overdue is not stored but computed from
the age (:mod:`app.live.age`), so that a silent worker cannot keep anything looking fresh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import structlog

from bus.catalogue.values import MOST_DECIMALS
from bus.contract import (
    BusFigures,
    BusLink,
    ParameterValue,
    Reading,
    Snapshot,
    Staged,
    UnitLink,
    UnitState,
    Update,
)
from bus.settings import BusSettings, UnitSettings

log = structlog.get_logger()

MODE, DECIMALS = 8, 3
NO_WORKER = "the bus worker is not connected"

Subscriber = Callable[[str, Sequence[Update]], None]


@dataclass(slots=True)
class UnitLive:
    """The newest word of one unit. ``link`` is the worker's opinion; the age has a say too."""

    settings: UnitSettings
    link: UnitLink
    reading: Reading | None = None
    parameters: dict[int, ParameterValue] = field(default_factory=dict)
    staged: int | None = None

    def parameter_raw(self, number: int) -> int | None:
        """The raw value of a parameter as last read; None when never read or not available, and for decimals
        (#3) that no value can have."""
        known = self.parameters.get(number)
        raw = known.raw if known is not None else None
        return None if raw is not None and number == DECIMALS and raw > MOST_DECIMALS else raw


@dataclass(slots=True)
class BusLive:
    """One bus: its port as the worker sees it, its figures, its units in floor order."""

    settings: BusSettings
    link: BusLink
    worker_connected: bool = False
    worker_software: str = ""
    figures: BusFigures | None = None
    units: dict[int, UnitLive] = field(default_factory=dict)

    @property
    def baud(self) -> int:
        """The present rate: what the worker says, as #18 may have moved it; else as configured."""
        return self.link.baud or self.settings.baud


class LiveState:
    """Every configured bus, changed only by :meth:`apply` and its relatives."""

    def __init__(self, buses: Iterable[BusSettings], started_at: float) -> None:
        self.buses = {settings.name: _never_seen(settings, started_at) for settings in buses}
        self._subscribers: list[Subscriber] = []

    def subscribe(self, subscriber: Subscriber) -> Callable[[], None]:
        """Call ``subscriber(bus_name, updates)`` after each change; the result ends it."""
        self._subscribers.append(subscriber)
        return lambda: self._subscribers.remove(subscriber)

    def apply(self, bus: str, updates: Sequence[Update]) -> None:
        """Take in what a worker reported, in order, and tell the subscribers; none of them can stop it.

        Raises KeyError for a bus that is not configured; a unit that is not is passed over.
        """
        live = self.buses[bus]
        for update in updates:
            _apply_one(live, update)
        for subscriber in tuple(self._subscribers):
            try:
                subscriber(bus, updates)
            except Exception:
                log.exception("subscriber of the live state failed", bus=bus)

    def worker_came(self, bus: str, snapshot: Snapshot, software: str) -> list[Update]:
        """A worker said hello and told its whole state; gives that as updates."""
        live = self.buses[bus]
        live.worker_connected = True
        live.worker_software = software
        updates = updates_of(snapshot)
        self.apply(bus, updates)
        return updates

    def worker_went(self, bus: str, at: float, cause: str = NO_WORKER) -> list[Update]:
        """The worker's connection ended: the port counts as closed, nothing counts as fresh."""
        live = self.buses[bus]
        live.worker_connected = False
        live.figures = None
        updates: list[Update] = [BusLink(at=at, link="closed", cause=cause)]
        updates += [
            UnitLink(unit=unit.settings.id, at=at, link="stale", cause=cause)
            for unit in live.units.values()
            if unit.link.link == "online"
        ]
        self.apply(bus, updates)
        return updates


def follower(unit: UnitLive) -> bool | None:
    """Whether #8 makes the unit follow a master by a ratio; None while it was not read."""
    mode = unit.parameter_raw(MODE)
    return None if mode is None else mode in (1, 2)


def updates_of(snapshot: Snapshot) -> list[Update]:
    """A whole state as the updates that lead to it."""
    updates: list[Update] = [snapshot.bus]
    for unit in snapshot.units:
        updates += _updates_of_unit(unit, snapshot.sent_at)
    if snapshot.figures is not None:
        updates.append(snapshot.figures)
    return updates


def _updates_of_unit(state: UnitState, at: float) -> list[Update]:
    updates: list[Update] = [state.link]
    if state.reading is not None:
        updates.append(state.reading)
    updates += state.parameters
    updates.append(Staged(unit=state.unit, at=at, raw=state.staged))
    return updates


def _never_seen(settings: BusSettings, at: float) -> BusLive:
    units = {
        unit.id: UnitLive(settings=unit, link=UnitLink(unit=unit.id, at=at, link="unknown"))
        for unit in settings.unit
    }
    link = BusLink(at=at, link="closed", cause=NO_WORKER)
    return BusLive(settings=settings, link=link, units=units)


def _apply_one(live: BusLive, update: Update) -> None:
    match update:
        case BusLink():
            live.link = update
        case BusFigures():
            live.figures = update
        case Reading() | UnitLink() | ParameterValue() | Staged():
            unit = live.units.get(update.unit)
            if unit is not None:
                _apply_to_unit(unit, update)


def _apply_to_unit(unit: UnitLive, update: Reading | UnitLink | ParameterValue | Staged) -> None:
    match update:
        case Reading():
            unit.reading = update
        case UnitLink():
            unit.link = update
        case ParameterValue():
            unit.parameters[update.number] = update
        case Staged():
            unit.staged = update.raw

"""The present state of every bus and unit. It has one writer: what the workers report.

A command never changes it. Times are seconds since the epoch on the app's own clock; the feed
shifts a worker's times before they come here. What is overdue is not stored but computed from
the age (:mod:`app.live.state.age`), so that a silent worker cannot keep anything looking fresh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import structlog

from app.live.state.bus_live import BusLive, UnitLive, follower, never_seen
from app.live.state.onset import Onset
from app.live.state.snapshot import updates_of
from bus.contract import BusFigures, BusLink, ParameterValue, Reading, Snapshot, Staged, UnitLink, Update
from bus.messages import Message
from bus.settings import BusSettings

__all__ = ["NO_WORKER", "BusLive", "LiveState", "Subscriber", "UnitLive", "follower"]

log = structlog.get_logger()

NO_WORKER = Message("worker_not_connected")

Subscriber = Callable[[str, Sequence[Update]], None]


class LiveState:
    """Every configured bus, changed only by :meth:`apply` and its relatives."""

    def __init__(self, buses: Iterable[BusSettings], started_at: float) -> None:
        self.buses = {settings.name: never_seen(settings, started_at, NO_WORKER) for settings in buses}
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
        if not live.worker_connected:
            live.worker_lost = None
            # It says how its port is, and not since when.
            live.link, live.link_onset = snapshot.bus, Onset(snapshot.bus.at, exact=False)
        live.worker_software = software
        updates = updates_of(snapshot)
        self.apply(bus, updates)
        return updates

    def worker_went(self, bus: str, at: float, cause: Message = NO_WORKER) -> list[Update]:
        """The worker's connection ended: the port counts as closed, nothing counts as fresh."""
        live = self.buses[bus]
        live.worker_lost = Onset(at)
        live.figures = None
        updates: list[Update] = [BusLink(at=at, link="closed", cause=cause)]
        updates += [
            UnitLink(unit=unit.settings.id, at=at, link="stale", cause=cause)
            for unit in live.units.values()
            if unit.link.link == "online"
        ]
        self.apply(bus, updates)
        return updates


def _apply_one(live: BusLive, update: Update) -> None:
    match update:
        case BusLink():
            live.take_link(update)
        case BusFigures():
            live.figures = update
        case Reading() | UnitLink() | ParameterValue() | Staged():
            unit = live.units.get(update.unit)
            if unit is not None:
                _apply_to_unit(live, unit, update)


def _apply_to_unit(
    live: BusLive, unit: UnitLive, update: Reading | UnitLink | ParameterValue | Staged
) -> None:
    match update:
        case Reading():
            live.take_reading(unit, update)
        case UnitLink():
            unit.link = update
        case ParameterValue():
            unit.parameters[update.number] = update
        case Staged():
            unit.staged = update.raw

"""Writes what is kept of the workers' updates within one transaction."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from app.history.series.runs import PlainRun, micros, plain_run
from app.history.series.scaling import DECIDING, ParameterStep
from app.history.store import tables
from bus.contract import BusLink, ParameterValue, Reading, UnitLink, Update
from bus.messages import in_english

BUS = 0
"""The number under which a bus itself has its key."""
Delivery = tuple[str, Sequence[Update]]
"""A bus and what its worker reported."""


@dataclass(slots=True)
class Taken:
    """What one transaction has, to be put into the tail once it is on disk."""

    rows: list[tuple[int, PlainRun]] = field(default_factory=list)
    lost: list[tuple[int, int]] = field(default_factory=list)
    """Units that stopped responding, and when, µs."""


class Intake:
    """Knows the keys of the units, and the last state of each link, to keep changes only."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """After a transaction that was rolled back: known values may not be on disk."""
        self._keys: dict[str, dict[int, int]] = {}
        self._links: dict[int, tuple[int, str]] = {}

    def take(self, connection: tables.StoreConnection, deliveries: Iterable[Delivery]) -> Taken:
        """Links and parameters of these deliveries, into this transaction; their readings are returned."""
        taken = Taken()
        for bus, updates in deliveries:
            keys = self._keys.setdefault(bus, {})
            for update in updates:
                if type(update) is Reading:
                    key = keys.get(update.unit) or self.key(connection, bus, update.unit)
                    taken.rows.append((key, plain_run(update)))
                elif isinstance(update, UnitLink | BusLink):
                    self._write_link(connection, bus, update, taken)
                elif isinstance(update, ParameterValue):
                    self._write_parameter(connection, bus, update)
        return taken

    def key(self, connection: tables.StoreConnection, bus: str, number: int) -> int:
        """The key of a unit, or of a bus as number 0."""
        keys = self._keys.setdefault(bus, {})
        if number not in keys:
            keys[number] = tables.unit_id(connection, bus, number)
        return keys[number]

    def _write_link(
        self, connection: tables.StoreConnection, bus: str, update: UnitLink | BusLink, taken: Taken
    ) -> None:
        key = self.key(connection, bus, update.unit if isinstance(update, UnitLink) else BUS)
        at = micros(update.at)
        newest, state = self._links.get(key, (at, ""))
        if at >= newest:
            self._links[key] = (at, update.link)
            if state == update.link:
                return
        tables.write_link(connection, key, at, update.link, in_english(update.cause))
        if update.link in tables.LOST_STATES:
            units = tables.units_of(connection, bus) if isinstance(update, BusLink) else [key]
            taken.lost += [(unit, at) for unit in units]

    def _write_parameter(self, connection: tables.StoreConnection, bus: str, update: ParameterValue) -> None:
        if update.number not in DECIDING or update.raw is None:
            return
        key = self.key(connection, bus, update.unit)
        step = ParameterStep(micros(update.at), update.number, update.raw)
        known = [each for each in tables.parameter_steps(connection, key) if each.number == step.number]
        # Before its first value, that one counts.
        in_force = next((each for each in reversed(known) if each.at <= step.at), known[0] if known else None)
        if in_force is None or in_force.raw != step.raw:
            tables.write_parameter(connection, key, step)

"""What an engineer allows for each unit's speed, kept in the store and at hand for the rules.

All four are raw integers of the unit's own setpoint: display units, or the ratio times 10000
where the unit is a follower.
"""

from __future__ import annotations

import sqlite3
from dataclasses import astuple, dataclass
from functools import partial

from app.database import Database
from bus.instants import UnixTime
from bus.messages import Message, listed, term

HIGHEST_SETPOINT = 99999
"""Manual, command 82h."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Of one unit. None: no limit. ``per_minute``: how far the setpoint may move within a minute."""

    lowest: int | None = None
    highest: int | None = None
    largest_step: int | None = None
    per_minute: int | None = None

    @property
    def message(self) -> Message:
        parts = [
            Message(code, {"value": limit})
            for code, limit in (
                ("limit_lowest", self.lowest),
                ("limit_highest", self.highest),
                ("limit_largest_step", self.largest_step),
                ("limit_per_minute", self.per_minute),
            )
            if limit is not None
        ]
        return listed(parts) if parts else term("none")

    def __str__(self) -> str:
        return str(self.message)


NO_LIMITS = Limits()


class LimitsStore:
    """The limits of the units of one bus: read once, written through."""

    def __init__(self, database: Database, bus: str) -> None:
        self._database = database
        self._bus = bus
        self._limits: dict[int, Limits] = {}

    async def load(self) -> None:
        """Load from the database; once, before the first command."""
        self._limits = await self._database.read(partial(_select, bus=self._bus))

    def of(self, unit: int) -> Limits:
        """The limits of a unit; without any, all that the protocol allows."""
        return self._limits.get(unit, NO_LIMITS)

    async def put(self, unit: int, limits: Limits, set_by: str, set_at: UnixTime) -> None:
        await self._database.write(lambda store: _replace(store, self._bus, unit, limits, set_by, set_at))
        self._limits[unit] = limits


def _select(store: sqlite3.Connection, bus: str) -> dict[int, Limits]:
    columns = "unit, lowest, highest, largest_step, per_minute"
    rows = store.execute(f"SELECT {columns} FROM limits WHERE bus = ?", (bus,))
    return {unit: Limits(*limits) for unit, *limits in rows}


def _replace(
    store: sqlite3.Connection, bus: str, unit: int, limits: Limits, set_by: str, set_at: UnixTime
) -> None:
    store.execute(
        "INSERT OR REPLACE INTO limits (bus, unit, lowest, highest, largest_step, per_minute, set_by, set_at)"
        " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
        (bus, unit, *astuple(limits), set_by, set_at),
    )

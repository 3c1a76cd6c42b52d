"""The restrictions that people set on a bus: limits of setpoints, blocks of units, the read-only mode.

All four limits are raw integers of the unit's own setpoint: display units, or the ratio times 10000 for a
follower. A read-only bus accepts only commands that make it slower, for a time or until an administrator ends
the mode: people at the line who may not end it can still slow the line down.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import astuple, dataclass, replace
from typing import Any

from app.core.database import Database, StoreConnection
from app.core.database.connection import upsert
from app.core.web.access import account_shown
from bus.instants import Monotonic, UnixTime
from bus.messages import Message, listed, term

HIGHEST_SETPOINT = 99999
"""The highest setpoint of the manual, command 82h."""


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits of a unit; None is no limit. ``per_minute``: how far the setpoint may move within a minute.
    ``decimals``: those of the display for which they were typed; None if they were given raw."""

    lowest: int | None = None
    highest: int | None = None
    largest_step: int | None = None
    per_minute: int | None = None
    decimals: int | None = None

    @property
    def are_set(self) -> bool:
        """Whether there is any limit."""
        return replace(self, decimals=None) != NO_LIMITS

    @property
    def message(self) -> Message:
        """Return the limits as a message for events."""
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


NO_LIMITS = Limits()


@dataclass(frozen=True, slots=True)
class CommandBlock:
    """The block of a unit: the reason, who set it, and when (Unix time)."""

    reason: str
    set_by: str
    set_at: UnixTime

    def refusal(self, unit: int) -> Message:
        """Return the reason why a command to the unit is not sent."""
        return Message.of("unit_blocked", unit=unit, who=account_shown(self.set_by), reason=self.reason)


@dataclass(frozen=True, slots=True)
class ReadOnly:
    """The read-only mode of a bus: the reason, who set it, when and until when (None: no end), Unix times."""

    reason: str
    set_by: str
    set_at: UnixTime
    until: UnixTime | None = None

    def refusal(self) -> Message:
        """Return the reason why a command is not sent to the bus."""
        return Message.of("bus_read_only", who=account_shown(self.set_by), reason=self.reason)


MAX_READ_ONLY_MINUTES = 7 * 24 * 60
"""A longer time is a matter for the role of an account, or for the configuration."""
Row = tuple[Any, ...]
Protection = dict[str, list[Row]]
"""The rows of each table, by its name."""
_COLUMNS = {
    "blocks": ("bus, unit", "reason, set_by, set_at"),
    "limits": ("bus, unit", "lowest, highest, largest_step, per_minute, set_by, set_at"),
    "limits_scale": ("bus, unit", "decimals"),
    "read_only": ("bus", "reason, set_by, set_at, until"),
}
"""The key and the other columns of each table, by its name."""
_PROTECTION = ("blocks", "limits", "limits_scale")


class Restrictions:
    """The limits, blocks and read-only mode of one bus: read once, every change written at once.

    The duration of the mode is measured by the monotonic clock: setting the wall clock neither ends nor
    prolongs it.
    """

    def __init__(self, database: Database, bus: str) -> None:
        self._database = database
        self._bus = bus
        self._limits: dict[int, Limits] = {}
        self._blocks: dict[int, CommandBlock] = {}
        self._read_only: ReadOnly | None = None
        self._ends_at = Monotonic(math.inf)

    async def load(self, now: UnixTime, monotonic: Monotonic) -> None:
        """Load from the database; once, before the first command."""
        rows = await self._database.read(
            lambda store: {table: _rows(store, table, self._bus) for table in _COLUMNS}
        )
        decimals = {unit: places for _, unit, places in rows["limits_scale"]}
        self._limits = {
            unit: replace(Limits(*limits), decimals=decimals.get(unit))
            for _, unit, *limits, _, _ in rows["limits"]
        }
        self._blocks = {unit: CommandBlock(*block) for _, unit, *block in rows["blocks"]}
        self._set_read_only(next((ReadOnly(*mode) for _, *mode in rows["read_only"]), None), now, monotonic)

    def limits(self, unit: int) -> Limits:
        """Return the limits of a unit."""
        return self._limits.get(unit, NO_LIMITS)

    def block(self, unit: int) -> CommandBlock | None:
        """Return the block of a unit, or None."""
        return self._blocks.get(unit)

    def read_only(self, monotonic: Monotonic) -> ReadOnly | None:
        """Return the read-only mode while it lasts, or None."""
        return self._read_only if monotonic < self._ends_at else None

    def read_only_left_s(self, monotonic: Monotonic) -> float:
        """Return the seconds that the mode still lasts, infinite if it has no end, 0 if it is not set."""
        return 0.0 if self._read_only is None else max(self._ends_at - monotonic, 0.0)

    async def put_limits(self, unit: int, limits: Limits, set_by: str, set_at: UnixTime) -> None:
        """Replace the limits of a unit."""
        *values, decimals = astuple(limits)

        def write(store: StoreConnection) -> None:
            _replace(store, "limits", [(self._bus, unit, *values, set_by, set_at)])
            _replace(store, "limits_scale", [(self._bus, unit, decimals)])

        await self._database.write(write)
        self._limits[unit] = limits

    async def put_block(self, unit: int, block: CommandBlock) -> None:
        """Block a unit, or replace the reason of its block."""
        row = self._bus, unit, *astuple(block)
        await self._database.write(lambda store: _replace(store, "blocks", [row]))
        self._blocks[unit] = block

    async def lift_block(self, unit: int) -> None:
        """Lift the block of a unit."""
        delete = "DELETE FROM blocks WHERE bus = ? AND unit = ?"
        await self._database.write(lambda store: store.execute(delete, (self._bus, unit)))
        self._blocks.pop(unit, None)

    async def put_read_only(self, mode: ReadOnly, monotonic: Monotonic) -> None:
        """Begin the read-only mode, or replace its reason and time."""
        row = self._bus, *astuple(mode)
        await self._database.write(lambda store: _replace(store, "read_only", [row]))
        self._set_read_only(mode, mode.set_at, monotonic)

    async def end_read_only(self) -> None:
        """End the read-only mode."""
        delete = "DELETE FROM read_only WHERE bus = ?"
        await self._database.write(lambda store: store.execute(delete, (self._bus,)))
        self._read_only = None

    def _set_read_only(self, mode: ReadOnly | None, now: UnixTime, monotonic: Monotonic) -> None:
        self._read_only = mode
        lasts_s = math.inf if mode is None or mode.until is None else mode.until - now
        self._ends_at = monotonic + lasts_s


def read_protection(store: StoreConnection) -> Protection:
    """Read every limit and block of a store, of any version. Raise StoreError if it cannot be read."""
    tables = {name for (name,) in store.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    return {table: _rows(store, table) for table in _PROTECTION if table in tables}


def keep_in_force(restored: StoreConnection, protection: Protection) -> None:
    """Apply the limits and blocks that were in force before a store was restored from a backup.

    They replace those of the same units; others of the restored store stay.
    """
    for table, rows in protection.items():
        _replace(restored, table, rows)


def _rows(store: StoreConnection, table: str, bus: str | None = None) -> list[Row]:
    """Return the rows of a bus, or all rows without ``bus``."""
    where, values = ("", ()) if bus is None else (" WHERE bus = ?", (bus,))
    query = f"SELECT {', '.join(_COLUMNS[table])} FROM {table}{where}"
    return [tuple(row) for row in store.execute(query, values)]


def _replace(store: StoreConnection, table: str, rows: Iterable[Row]) -> None:
    keys, values = (names.split(", ") for names in _COLUMNS[table])
    store.executemany(upsert(table, keys, values), rows)

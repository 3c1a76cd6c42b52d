"""Speed limits and command blocks of units, kept in the store and at hand for the rules.

All four limits are raw integers of the unit's own setpoint: display units, or the ratio times 10000 where the
unit is a follower.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, dataclass, replace
from typing import Any

from app.core.database import Database, StoreConnection
from app.core.database.connection import upsert
from app.core.web.admission.access import account_shown
from bus.instants import UnixTime
from bus.messages import Message, listed, term

HIGHEST_SETPOINT = 99999
"""Manual, command 82h."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a unit; None is no limit. ``per_minute``: how far the setpoint may move within a minute.
    ``decimals``: of the display for which they were typed; None where they were given raw."""

    lowest: int | None = None
    highest: int | None = None
    largest_step: int | None = None
    per_minute: int | None = None
    decimals: int | None = None

    @property
    def are_set(self) -> bool:
        """Whether there is any."""
        return replace(self, decimals=None) != NO_LIMITS

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
Row = tuple[Any, ...]
Protection = dict[str, list[Row]]
"""Table → its rows."""
_COLUMNS = {
    "blocks": "bus, unit, reason, set_by, set_at",
    "limits": "bus, unit, lowest, highest, largest_step, per_minute, set_by, set_at",
    "limits_scale": "bus, unit, decimals",
}


class LimitsStore:
    """The limits of the units of one bus: read once, written through."""

    def __init__(self, database: Database, bus: str) -> None:
        self._database = database
        self._bus = bus
        self._limits: dict[int, Limits] = {}

    async def load(self) -> None:
        """Load from the database; once, before the first command."""
        rows = await self._database.read(lambda store: _rows(store, "limits", self._bus))
        scales = await self._database.read(lambda store: _rows(store, "limits_scale", self._bus))
        decimals = {unit: places for _, unit, places in scales}
        self._limits = {
            unit: replace(Limits(*limits), decimals=decimals.get(unit)) for _, unit, *limits, _, _ in rows
        }

    def of(self, unit: int) -> Limits:
        """The limits of a unit; without any, all that the protocol allows."""
        return self._limits.get(unit, NO_LIMITS)

    async def put(self, unit: int, limits: Limits, set_by: str, set_at: UnixTime) -> None:
        *values, decimals = astuple(limits)

        def write(store: StoreConnection) -> None:
            _replace(store, "limits", [(self._bus, unit, *values, set_by, set_at)])
            _replace(store, "limits_scale", [(self._bus, unit, decimals)])

        await self._database.write(write)
        self._limits[unit] = limits


@dataclass(frozen=True, slots=True)
class CommandBlock:
    """Why a unit is blocked, by whom, since when (seconds since the epoch)."""

    reason: str
    set_by: str
    set_at: UnixTime

    def refusal(self, unit: int) -> Message:
        """Why a command to its unit is not sent."""
        return Message.of("unit_blocked", unit=unit, who=account_shown(self.set_by), reason=self.reason)


class BlockStore:
    """The blocks of the units of one bus: read once, written through."""

    def __init__(self, database: Database, bus: str) -> None:
        self._database = database
        self._bus = bus
        self._blocks: dict[int, CommandBlock] = {}

    async def load(self) -> None:
        """Load from the database; once, before the first command."""
        rows = await self._database.read(lambda store: _rows(store, "blocks", self._bus))
        self._blocks = {unit: CommandBlock(*block) for _, unit, *block in rows}

    def of(self, unit: int) -> CommandBlock | None:
        """The block of a unit, or None."""
        return self._blocks.get(unit)

    async def put(self, unit: int, block: CommandBlock) -> None:
        """Block a unit, or give another reason."""
        row = self._bus, unit, *astuple(block)
        await self._database.write(lambda store: _replace(store, "blocks", [row]))
        self._blocks[unit] = block

    async def lift(self, unit: int) -> None:
        delete = "DELETE FROM blocks WHERE bus = ? AND unit = ?"
        await self._database.write(lambda store: store.execute(delete, (self._bus, unit)))
        self._blocks.pop(unit, None)


def read_protection(store: StoreConnection) -> Protection:
    """Every limit and block of a store, of any version. Raises StoreError for one that cannot be read."""
    tables = {name for (name,) in store.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    return {table: _rows(store, table) for table in _COLUMNS if table in tables}


def keep_in_force(restored: StoreConnection, protection: Protection) -> None:
    """Apply the limits and blocks that were in force before a store was restored from a backup.

    They replace those of the same units; others of the restored store stay.
    """
    for table, rows in protection.items():
        _replace(restored, table, rows)


def _rows(store: StoreConnection, table: str, bus: str | None = None) -> list[Row]:
    """The rows of a bus, or without ``bus`` of every one."""
    where, values = ("", ()) if bus is None else (" WHERE bus = ?", (bus,))
    return [tuple(row) for row in store.execute(f"SELECT {_COLUMNS[table]} FROM {table}{where}", values)]


def _replace(store: StoreConnection, table: str, rows: Iterable[Row]) -> None:
    columns = _COLUMNS[table].split(", ")
    store.executemany(upsert(table, columns[:2], columns[2:]), rows)

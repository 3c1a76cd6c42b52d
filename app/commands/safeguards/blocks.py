"""Units that must not be commanded, each with a reason and a name, until someone lifts it."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass
from functools import partial

from app.database import Database
from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class CommandBlock:
    """Why a unit is blocked, by whom, since when (seconds since the epoch)."""

    reason: str
    set_by: str
    set_at: UnixTime


class BlockStore:
    """The blocks of the units of one bus: read once, written through."""

    def __init__(self, database: Database, bus: str) -> None:
        self._database = database
        self._bus = bus
        self._blocks: dict[int, CommandBlock] = {}

    async def load(self) -> None:
        """Load from the database; once, before the first command."""
        self._blocks = await self._database.read(partial(_select, bus=self._bus))

    def of(self, unit: int) -> CommandBlock | None:
        """The block of a unit, or None."""
        return self._blocks.get(unit)

    async def put(self, unit: int, block: CommandBlock) -> None:
        """Block a unit, or give another reason."""
        await self._database.write(lambda store: _replace(store, self._bus, unit, block))
        self._blocks[unit] = block

    async def lift(self, unit: int) -> None:
        await self._database.write(lambda store: _delete(store, self._bus, unit))
        self._blocks.pop(unit, None)


def _select(store: sqlite3.Connection, bus: str) -> dict[int, CommandBlock]:
    rows = store.execute("SELECT unit, reason, set_by, set_at FROM blocks WHERE bus = ?", (bus,))
    return {unit: CommandBlock(*block) for unit, *block in rows}


def _replace(store: sqlite3.Connection, bus: str, unit: int, block: CommandBlock) -> None:
    store.execute(
        "INSERT OR REPLACE INTO blocks (bus, unit, reason, set_by, set_at) VALUES (?, ?, ?, ?, ?)",
        (bus, unit, block.reason, block.set_by, block.set_at),
    )


def _delete(store: sqlite3.Connection, bus: str, unit: int) -> None:
    store.execute("DELETE FROM blocks WHERE bus = ? AND unit = ?", (bus, unit))

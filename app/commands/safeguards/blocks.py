"""Units that must not be commanded, each with a reason and a name, until someone lifts it."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass

from app.database import Database


@dataclass(frozen=True, slots=True)
class CommandBlock:
    """Why a unit is blocked, by whom, since when (seconds since the epoch)."""

    reason: str
    set_by: str
    set_at: float


class BlockStore:
    """Every block: read once, written through."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._blocks: dict[tuple[str, int], CommandBlock] = {}

    async def load(self) -> None:
        """Read what is stored; once, before the first command."""
        self._blocks = await self._database.read(_select_all)

    def of(self, bus: str, unit: int) -> CommandBlock | None:
        """The block of a unit, or None."""
        return self._blocks.get((bus, unit))

    async def put(self, bus: str, unit: int, block: CommandBlock) -> None:
        """Block a unit, or give another reason."""
        await self._database.write(lambda store: _replace(store, bus, unit, block))
        self._blocks[bus, unit] = block

    async def lift(self, bus: str, unit: int) -> None:
        """Free a unit."""
        await self._database.write(lambda store: _delete(store, bus, unit))
        self._blocks.pop((bus, unit), None)


def _select_all(store: sqlite3.Connection) -> dict[tuple[str, int], CommandBlock]:
    rows = store.execute("SELECT bus, unit, reason, set_by, set_at FROM blocks")
    return {(bus, unit): CommandBlock(reason, set_by, set_at) for bus, unit, reason, set_by, set_at in rows}


def _replace(store: sqlite3.Connection, bus: str, unit: int, block: CommandBlock) -> None:
    store.execute(
        "INSERT OR REPLACE INTO blocks (bus, unit, reason, set_by, set_at) VALUES (?, ?, ?, ?, ?)",
        (bus, unit, block.reason, block.set_by, block.set_at),
    )


def _delete(store: sqlite3.Connection, bus: str, unit: int) -> None:
    store.execute("DELETE FROM blocks WHERE bus = ? AND unit = ?", (bus, unit))

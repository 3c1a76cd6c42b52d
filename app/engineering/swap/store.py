"""Stores the swap of each section, so that it continues after a restart."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from app.core.database import StoreConnection
from app.core.database.connection import upsert
from app.core.database.database import Tables, writing
from app.core.database.messages import messages_of, stored_messages
from app.engineering.sets.restore.record import Restore
from app.engineering.swap.record import Swap, SwapSource

_VALUES = ("who", "began_at", "set_id", "set_unit", "is_new", "proven", "restore_id", "seen")
FindRestore = Callable[[str], Awaitable[Restore | None]]


class SwapStore(Tables):
    """All access to the table of swaps."""

    @writing
    def save(self, connection: StoreConnection, swap: Swap) -> None:
        """Store the present state in place of the section's earlier one."""
        row = (
            swap.bus,
            swap.unit,
            swap.who,
            swap.began_at,
            swap.source.set if swap.source else None,
            swap.source.unit if swap.source else None,
            swap.is_new,
            swap.proven,
            swap.restore.id if swap.restore else None,
            stored_messages(swap.seen),
        )
        connection.execute(upsert("swap", ("bus", "unit"), _VALUES), row)

    @writing
    def remove(self, connection: StoreConnection, swap: Swap) -> None:
        connection.execute("DELETE FROM swap WHERE bus = ? AND unit = ?", (swap.bus, swap.unit))

    async def load(self, bus: str, find_restore: FindRestore) -> list[Swap]:
        """Every swap of a bus that was not left, with the restore that it led to."""
        rows = await self.database.read(lambda connection: _select(connection, bus))
        for swap, restore_id in rows:
            swap.restore = await find_restore(restore_id) if restore_id else None
        return [swap for swap, _ in rows]


def _select(connection: StoreConnection, bus: str) -> list[tuple[Swap, str | None]]:
    found = connection.execute(
        "SELECT bus, unit, who, began_at, set_id, set_unit, is_new, proven, seen, restore_id FROM swap"
        " WHERE bus = ?",
        (bus,),
    )
    return [
        (
            Swap(
                bus,
                unit,
                who,
                None if set_id is None else SwapSource(set_id, set_unit),
                began_at,
                is_new=bool(is_new),
                proven=bool(proven),
                seen=messages_of(seen),
            ),
            restore_id,
        )
        for bus, unit, who, began_at, set_id, set_unit, is_new, proven, seen, restore_id in found
    ]

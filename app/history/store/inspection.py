"""Looks for damage once a day. A damaged block is set aside: it costs itself, and leaves a hole.

SQLite's own check follows the pages; the checksum of each block is compared separately, as SQLite does not
know its content.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime

from app.database import Database
from app.history.series.runs import SECOND, micros
from app.history.store import tables
from app.history.store.damage import BlockKey, StoredTier, sound
from bus.instants import monotonic_now, unix_now
from bus.messages import Message

FoundDamage = Callable[[Message], None]
"""Called from the writer's thread with what becomes an event."""
_HELD: dict[StoredTier, Message] = {
    "raw": Message("history_readings"),
    "minutes": Message("history_minutes"),
    "hours": Message("history_hours"),
}


def set_aside(database: Database, block: BlockKey, on_damage: FoundDamage) -> None:
    """Move a block where it is damaged, and report it. Raises StoreError."""

    def move(connection: tables.StoreConnection) -> str | None:
        is_moved = tables.move_damaged(connection, block, micros(unix_now()))
        return tables.name_of(connection, block.unit) if is_moved else None

    unit = database.write_now(move)
    if unit is not None:
        since = datetime.fromtimestamp(block.start / SECOND, UTC).isoformat(timespec="minutes")
        what = _HELD[block.tier]
        on_damage(Message.of("event_history_block_lost", what=what, unit=unit, since=since))


TABLES = (*_HELD, "bits", "link", "parameter", "journal")
MAX_AT_ONCE = 20
REST = 4
"""How many times as long as each look took the check rests: a fifth of a core at most, and not for long."""


async def damaged_blocks(database: Database) -> AsyncIterator[BlockKey]:
    """Every block whose content is not what was written."""
    for tier in _HELD:
        after = (-1, 0)
        while True:
            begun = monotonic_now()
            rows = await database.read(lambda c, tier=tier, after=after: _look(c, tier, after))  # type: ignore[misc]
            if not rows:
                break
            for unit, start, block in rows:
                if not block:
                    yield BlockKey(tier, unit, start)
            after = rows[-1][:2]
            await asyncio.sleep(REST * (monotonic_now() - begun))


def _look(
    connection: tables.StoreConnection, tier: StoredTier, after: tuple[int, int]
) -> list[tuple[int, int, bool]]:
    query = f"SELECT unit, start, data FROM {tier} WHERE (unit, start) > (?, ?) ORDER BY unit, start LIMIT ?"
    rows = connection.execute(query, (*after, MAX_AT_ONCE)).fetchall()
    return [(unit, start, sound(data)) for unit, start, data in rows]

"""Once a day all stored data is checked, so that damage is not found on the day when it is needed.

SQLite's own check follows the pages; the checksum of each block is compared separately, as SQLite does not
know its content.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from app.database.connection import Database
from app.history.store import tables
from app.history.store.damage import BlockKey, StoredTier, sound
from bus.instants import monotonic_now

TIERS: tuple[StoredTier, ...] = ("raw", "minutes", "hours")
TABLES = (*TIERS, "bits", "link", "parameter", "journal")
AT_ONCE = 20
REST = 4
"""How many times as long as each look took the check rests: a fifth of a core at most, and not for long."""


async def pages_are_intact(database: Database) -> bool:
    """SQLite's own check of every table. Raises DamagedStoreError where it cannot even be made."""
    for table in TABLES:
        query = f"PRAGMA quick_check({table})"
        rows = await database.read(lambda c, query=query: c.execute(query).fetchall())  # type: ignore[misc]
        if [row[0] for row in rows] != ["ok"]:
            return False
    return True


async def damaged_blocks(database: Database) -> AsyncIterator[BlockKey]:
    """Every block whose content is not what was written."""
    for tier in TIERS:
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
    rows = connection.execute(query, (*after, AT_ONCE)).fetchall()
    return [(unit, start, sound(data)) for unit, start, data in rows]

"""Finds damaged blocks once a day, sets them aside, and computes them again from finer data.

SQLite's own check follows the pages; the checksum of each block is compared separately, as SQLite does not
know its content.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime

from app.database.connection import Database
from app.history.series.rollup import Rollup, combine, rollup
from app.history.series.runs import DAY, HOUR, MINUTE, SECOND, Run, micros
from app.history.store import tables
from app.history.store.damage import BlockKey, DamagedBlock, StoredTier, sound
from bus.instants import monotonic_now, unix_now
from bus.messages import Message

FoundDamage = Callable[[Message], None]
"""Called from the writer's thread with what becomes an event."""
_HELD: dict[StoredTier, Message] = {
    "raw": Message("history_readings"),
    "minutes": Message("history_minutes"),
    "hours": Message("history_hours"),
}


class Repair:
    """Used by the thread that alone writes."""

    def __init__(self, database: Database, on_damage: FoundDamage) -> None:
        self._database = database
        self._on_damage = on_damage

    def set_aside(self, block: BlockKey) -> None:
        """Whatever is damaged of it and of what it is made from. Raises StoreError."""
        try:
            event = self._database.write_now(lambda c: _event_of(c, block))
        except DamagedBlock as finer:
            self.set_aside(finer.block)
            self.set_aside(block)
            return
        if event is not None:
            self._on_damage(event)


def _event_of(connection: tables.StoreConnection, block: BlockKey) -> Message | None:
    """Set it aside where it is damaged, as an event."""
    if not tables.is_damaged(connection, block):
        return None
    missing = set_aside(connection, block, micros(unix_now()))
    since = datetime.fromtimestamp(block.start / SECOND, UTC).isoformat(timespec="minutes")
    code = "event_history_block_lost" if missing else "event_history_block_rebuilt"
    return Message.of(code, what=_HELD[block.tier], unit=tables.name_of(connection, block.unit), since=since)


def set_aside(connection: tables.StoreConnection, block: BlockKey, now: int) -> bool:
    """Gives whether nothing was there to work it out from: then something is missing.

    Raises DamagedBlock for a finer block that is damaged too: that one first.
    """
    tables.move_damaged(connection, block, now)
    if block.tier == "raw":
        return True
    rebuilt = _minutes(connection, block) if block.tier == "minutes" else _hours(connection, block)
    if rebuilt:
        tables.write_rollups(connection, block.tier, block.unit, block.start, rebuilt)
    return not rebuilt


def _minutes(connection: tables.StoreConnection, block: BlockKey) -> list[Rollup]:
    by_minute: dict[int, list[Run]] = {}
    for run in tables.raw_between(connection, block.unit, block.start, block.start + HOUR):
        by_minute.setdefault(run.at - run.at % MINUTE, []).append(run)
    return [rollup(runs, minute) for minute, runs in sorted(by_minute.items())]


def _hours(connection: tables.StoreConnection, block: BlockKey) -> list[Rollup]:
    hours = range(block.start, block.start + DAY, HOUR)
    found = ((hour, tables.rollup_row(connection, "minutes", block.unit, hour)) for hour in hours)
    return [combine(minutes, hour) for hour, minutes in found if minutes]


TIERS: tuple[StoredTier, ...] = ("raw", "minutes", "hours")
TABLES = (*TIERS, "bits", "link", "parameter", "journal")
MAX_AT_ONCE = 20
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
    rows = connection.execute(query, (*after, MAX_AT_ONCE)).fetchall()
    return [(unit, start, sound(data)) for unit, start, data in rows]

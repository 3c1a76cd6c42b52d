"""Keeps the store small and sound: packs hours, gives up old readings, minds the disk, looks for damage.

A damaged block is set aside: it costs itself, and leaves a hole. SQLite's own check follows the pages; the
checksum of each block is compared separately, as SQLite does not know its content.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from app.database import Database
from app.database.reserve import MIN_FREE_OF_OTHERS, free_bytes
from app.history import tables
from app.history.folding import compact
from app.history.series.runs import DAY, HOUR, MINUTE, SECOND, micros
from app.history.settings import HistorySettings
from app.history.status import StoreState
from app.history.tables import BlockKey, DamagedBlock, StoredTier, sound
from bus.instants import Monotonic, monotonic_now, unix_now
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


_MB = 1_000_000


@dataclass(frozen=True, slots=True)
class DiskReserve:
    """Free bytes below which each thing happens."""

    announce: int = 2_000 * _MB
    """Warn on every page that shows history."""
    trim: int = 500 * _MB
    """Give up the oldest readings; minutes and hours stay."""
    pause: int = MIN_FREE_OF_OTHERS
    """Write no history: the remaining space belongs to the main store, and below it is its own reserve."""


def space(free: int, reserve: DiskReserve) -> StoreState:
    """The state of a store on a disk with so many free bytes."""
    if free < reserve.pause:
        return "paused"
    if free < reserve.trim:
        return "scarce"
    return "low" if free < reserve.announce else "ok"


SETTLED_S = 3600.0
"""After a start or a clock step nothing is given up for its age for so long: the clock may be wrong."""
LATE = 10 * MINUTE
"""How long workers buffer while the app is away: an hour that ended longer ago is complete."""
MAX_DROPPED = 50
"""Blocks given up in one transaction."""
MAX_PAGES = 2000
"""Given back to the disk at a time."""


class Upkeep:
    """Called by the writer's thread between commits, for a short while each time."""

    def __init__(
        self,
        database: Database,
        kept: HistorySettings,
        reserve: DiskReserve,
        on_damage: FoundDamage,
    ) -> None:
        self._database = database
        self._kept = kept
        self._reserve = reserve
        self._on_damage = on_damage
        self._settled_at = monotonic_now() + SETTLED_S
        self._to_sweep = True

    def clock_stepped(self, now: int) -> None:
        """Old readings are uncertain for a while; ``now`` in µs, by the clock as it was set."""
        self._settled_at = monotonic_now() + SETTLED_S
        self._database.write_now(lambda c: tables.correct_raw_from(c, now))

    def look(self) -> tuple[int, StoreState]:
        """Free bytes where the store is, and what they mean."""
        free = free_bytes(self._database.path.parent)
        return free, space(free, self._reserve)

    def compact(self, now: int, deadline: Monotonic) -> None:
        """Pack hours that are over until ``deadline`` (monotonic seconds)."""
        before = now - now % HOUR
        if now - before < LATE:
            before -= HOUR
        while monotonic_now() < deadline:
            found = self._database.read_now(lambda c: tables.next_to_compact(c, before))
            if found is None:
                return
            try:
                self._database.write_now(lambda c, found=found: compact(c, *found))  # type: ignore[misc]
            except DamagedBlock as damaged:
                set_aside(self._database, damaged.block, self._on_damage)

    def give_up_old(self, now: int) -> None:
        """Choose the readings past their retention; :meth:`sweep` then deletes them."""
        if monotonic_now() < self._settled_at:
            return
        horizon = now - self._kept.raw_days * DAY
        self._give_up_before(horizon - horizon % HOUR)
        self._database.write_now(lambda c: tables.drop_rollups(c, now - self._kept.years * 365 * DAY))

    def trim(self, now: int) -> None:
        """Give up the oldest hour of readings, since the disk is short; the last hour is worth more than
        the little space it takes."""
        oldest = self._database.read_now(tables.oldest_packed)
        if oldest is not None and oldest - oldest % HOUR + HOUR <= now - HOUR:
            self._give_up_before(oldest - oldest % HOUR + HOUR)

    def sweep(self, deadline: Monotonic) -> None:
        """Take away what was given up, until ``deadline`` (monotonic seconds)."""
        while self._to_sweep and monotonic_now() < deadline:
            dropped = self._database.write_now(lambda c: tables.drop_raw(c, tables.raw_from(c), MAX_DROPPED))
            self._to_sweep = dropped == MAX_DROPPED
            self._database.give_back(MAX_PAGES)

    def _give_up_before(self, horizon: int) -> None:
        def move(connection: tables.StoreConnection) -> bool:
            further = horizon > tables.raw_from(connection)
            if further:
                tables.write_raw_from(connection, horizon)
            return further

        self._to_sweep = self._database.write_now(move) or self._to_sweep

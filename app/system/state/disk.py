"""The sizes of the stores, and how long the free space of their disk lasts."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from app.core.database.connection import examining
from app.core.database.migration import COMPANIONS
from app.errors import StoreError
from app.line.history.series.runs import micros
from app.line.history.service import FILE as HISTORY
from app.line.history.status import MAX_DAYS, days_left, growth_of_events, growth_of_history
from app.settings import STORE_FILE, Settings
from app.system.backup.stores import STORES
from bus.instants import UnixTime


def size_of(store: Path) -> int:
    """Return the bytes of a store with the files that SQLite has beside it."""
    total = 0
    for suffix in ("", *COMPANIONS):
        with suppress(OSError):
            total += store.with_name(store.name + suffix).stat().st_size
    return total


def store_sizes(data: Path) -> dict[str, int]:
    """Return the bytes of each store in a folder."""
    return {name: size for name in STORES if (size := size_of(data / name))}


def forecast(settings: Settings, stores: dict[str, int], free: int, now: UnixTime) -> float | None:
    """Return the days that the free bytes last, at most `MAX_DAYS`; None if not known yet."""
    data = settings.server.data
    if not {HISTORY, STORE_FILE} <= stores.keys():
        return None
    try:
        with examining(data / HISTORY) as connection:
            history = growth_of_history(connection, micros(now))
        with examining(data / STORE_FILE) as connection:
            events = growth_of_events(
                connection, stores[STORE_FILE], is_archived=settings.audit.archive is not None
            )
    except StoreError:
        return None
    if history is None:
        return None
    readings, rollups, stored_days = history
    left = days_left(free, readings, stored_days, settings.history.raw_days, rollups + events)
    return MAX_DAYS if left is None else left

"""For how many days the disk is enough, from what the stores grew by of late. The first function is pure."""

from __future__ import annotations

from app.audit.proof import cuts_of
from app.database import StoreConnection
from app.database.reserve import MIN_FREE_OF_OTHERS
from app.history.series.runs import DAY, HOUR

MAX_DAYS = 3650.0
LATELY = 7 * DAY
_RAW = "SELECT min(start), sum(length(data)) FROM raw WHERE start >= ?"
_OLDEST_RAW = "SELECT min(start) FROM raw"
_ROLLUPS = """
SELECT sum(length(data)) FROM unit JOIN minutes ON minutes.unit = unit.id AND minutes.start >= ?
"""
_EVENTS = "SELECT min(time), max(time) FROM events WHERE id > ?"


def days_left(free: int, readings: float, stored_days: float, kept_days: int, lasting: float) -> float | None:
    """Days until the space of the reserve is reached; None for longer than `MAX_DAYS`. ``readings``: bytes a
    day of what is deleted after ``kept_days``, of which ``stored_days`` are stored; ``lasting``: bytes a day
    of what stays for years."""
    usable, growing = max(0.0, free - MIN_FREE_OF_OTHERS), max(0.0, kept_days - stored_days)
    both = readings + lasting
    if both * growing > usable:
        return usable / both
    if not lasting:
        return None
    days = growing + (usable - both * growing) / lasting
    return days if days <= MAX_DAYS else None


def growth_of_history(connection: StoreConnection, now: int) -> tuple[float, float, float] | None:
    """Bytes a day of readings and of rollups in the last week, and the days of readings that are stored; None
    before an hour is stored. ``now``: µs since the epoch."""
    since = now - LATELY
    first, readings = connection.execute(_RAW, (since,)).fetchone()
    if first is None or now - first < HOUR:
        return None
    [oldest] = connection.execute(_OLDEST_RAW).fetchone()
    [rollups] = connection.execute(_ROLLUPS, (since,)).fetchone()
    days = (now - first) / DAY
    return readings / days, (rollups or 0) / days, (now - oldest) / DAY


def growth_of_events(connection: StoreConnection, size: int, *, is_archived: bool) -> float:
    """Bytes a day of the main store, which has ``size`` bytes, since the first event that is not archived.
    ``is_archived``: old events make room for new ones, from the first month that was archived."""
    cuts = cuts_of(connection)
    if cuts and is_archived:
        return 0.0
    first, last = connection.execute(_EVENTS, (cuts[-1].last if cuts else 0,)).fetchone()
    return 0.0 if first is None else size / max(1.0, (last - first) * 1e6 / DAY)

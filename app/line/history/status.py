"""The state of the history, for pages and the API, and how long the disk suffices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from app.core.database import StoreConnection
from app.core.database.files import MIN_FREE_OF_OTHERS
from app.core.web.formats import Formats
from app.core.web.shape import InstantObject, MessageObject
from app.line.history.series.runs import DAY, HOUR
from app.people.audit.proof import cuts_of
from bus.instants import UnixTime
from bus.messages import Message

StoreState = Literal["ok", "low", "scarce", "paused", "failed"]


@dataclass(frozen=True, slots=True)
class HistoryStatus:
    """State of the history. ``low``: the disk is nearly full; ``scarce``: the oldest readings go."""

    __pydantic_config__ = ConfigDict(json_schema_serialization_defaults_required=True)

    state: Annotated[
        StoreState,
        Field(description="low, scarce: little disk space; paused, failed: nothing is stored."),
    ] = "ok"
    message: Annotated[MessageObject | None, Field(description="What to do; null: nothing.")] = None
    cause: Annotated[
        MessageObject | None, Field(description="Why the store cannot be used; null: it can.")
    ] = None
    since: Annotated[InstantObject, Field(description="Since when.")] = UnixTime(0.0)
    size_bytes: int = 0
    free_bytes: Annotated[int, Field(description="Free space on the disk.")] = 0
    oldest_reading: Annotated[InstantObject | None, Field(description="null: none is stored.")] = None
    waiting: Annotated[int, Field(description="Updates that are not on disk yet.")] = 0
    lost: Annotated[int, Field(description="Updates that could not be stored.")] = 0
    damaged: Annotated[int, Field(description="Damages found in the last seven days.")] = 0
    put_aside: Annotated[
        str, Field(description="File of the damaged history, of the last seven days; empty: there is none.")
    ] = ""
    begun: Annotated[
        InstantObject | None, Field(description="When history began again; null: none was damaged.")
    ] = None


_MB = 1_000_000


@dataclass(frozen=True, slots=True)
class DiskReserve:
    """The free bytes below which each measure is taken."""

    announce: int = 2_000 * _MB
    """The free bytes below which every page with history has a warning."""
    trim: int = 500 * _MB
    """Give up the oldest readings; minutes and hours stay."""
    pause: int = MIN_FREE_OF_OTHERS
    """Write no history: the remaining space belongs to the main store, and below it is its own reserve."""


def space(free: int, reserve: DiskReserve) -> StoreState:
    """Return the state of a store on a disk with ``free`` bytes left."""
    if free < reserve.pause:
        return "paused"
    if free < reserve.trim:
        return "scarce"
    return "low" if free < reserve.announce else "ok"


NOTICES: dict[StoreState, Message] = {
    "low": Message("history_disk_low"),
    "scarce": Message("history_disk_scarce"),
    "paused": Message("history_disk_full"),
    "failed": Message("history_failed"),
}
DAMAGED = Message("history_damaged")


def damage_message(status: HistoryStatus, shown: Callable[[UnixTime], str]) -> Message | None:
    """Return the message about history that is missing since it was damaged; ``shown`` writes a time as
    text."""
    if status.begun is not None:
        return Message.of("history_put_aside", time=shown(status.begun), file=status.put_aside)
    return DAMAGED if status.damaged else None


def store_message(state: StoreState, cause: Message | None = None) -> Message | None:
    """Return the message about the state of the store; None if it is ok."""
    if state == "ok" or cause is None:
        return NOTICES.get(state)
    return Message.of("history_because", notice=NOTICES[state], cause=cause)


def store_notice(status: HistoryStatus, formats: Formats, now: UnixTime) -> Message | None:
    """Return the notice on the pages; None while history is stored."""
    since = formats.since(status.since, now)
    match status.state:
        case "ok":
            return damage_message(status, lambda at: formats.since(at, now))
        case "failed":
            return Message.of("history_failed_since", time=since, reason=status.cause or NOTICES["failed"])
        case "paused":
            return Message.of("history_paused_since", time=since)
        case _:
            return Message.of("history_notice", notice=NOTICES[status.state])


MAX_DAYS = 3650.0
LATELY = 7 * DAY
_RAW = "SELECT min(start), sum(length(data)) FROM raw WHERE start >= ?"
_OLDEST_RAW = "SELECT min(start) FROM raw"
_ROLLUPS = """
SELECT sum(length(data)) FROM unit JOIN minutes ON minutes.unit = unit.id AND minutes.start >= ?
"""
_EVENTS = "SELECT min(time), max(time) FROM events WHERE id > ?"


def days_left(free: int, readings: float, stored_days: float, kept_days: int, lasting: float) -> float | None:
    """Return the days until the reserve of the disk is reached; None if they are more than `MAX_DAYS`.
    ``readings``: bytes a day of data that is deleted after ``kept_days``, of which ``stored_days`` are
    stored; ``lasting``: bytes a day of data that stays for years."""
    usable, growing = max(0.0, free - MIN_FREE_OF_OTHERS), max(0.0, kept_days - stored_days)
    both = readings + lasting
    if both * growing > usable:
        return usable / both
    if not lasting:
        return None
    days = growing + (usable - both * growing) / lasting
    return days if days <= MAX_DAYS else None


def growth_of_history(connection: StoreConnection, now: int) -> tuple[float, float, float] | None:
    """Return the bytes a day of readings and of rollups in the last week, and the days of readings that are
    stored; None before an hour is stored. ``now``: µs since the epoch."""
    since = now - LATELY
    first, readings = connection.execute(_RAW, (since,)).fetchone()
    if first is None or now - first < HOUR:
        return None
    [oldest] = connection.execute(_OLDEST_RAW).fetchone()
    [rollups] = connection.execute(_ROLLUPS, (since,)).fetchone()
    days = (now - first) / DAY
    return readings / days, (rollups or 0) / days, (now - oldest) / DAY


def growth_of_events(connection: StoreConnection, size: int, *, is_archived: bool) -> float:
    """Return the bytes a day of the main store, which has ``size`` bytes, since the first event that is not
    archived. ``is_archived``: once a month was archived, old events make room for new ones."""
    cuts = cuts_of(connection)
    if cuts and is_archived:
        return 0.0
    first, last = connection.execute(_EVENTS, (cuts[-1].last if cuts else 0,)).fetchone()
    return 0.0 if first is None else size / max(1.0, (last - first) * 1e6 / DAY)

"""When a backup is due, and which files are too many. Pure. The clock may have been set by a year, in either
direction, since any of them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import datetime, time, timedelta
from zoneinfo import ZoneInfo

from bus.instants import UnixTime

NAME = re.compile(r"lineside-\d{4}-\d{2}-\d{2}-\d{6}\.tar")
RETRY_S = 3600.0
"""After one that failed."""


def next_after(now: UnixTime, at: str, zone: ZoneInfo) -> UnixTime:
    """The next moment after ``now`` at which the clock of the zone shows ``at``; on a day without it, the
    moment at which it would."""
    local = datetime.fromtimestamp(float(now), zone)
    due = datetime.combine(local.date(), time.fromisoformat(at), zone)
    while due.timestamp() <= float(now):
        due = datetime.combine(due.date() + timedelta(days=1), due.time(), zone)
    return UnixTime(due.timestamp())


def next_due(
    now: UnixTime, newest: UnixTime | None, failed: UnixTime | None, at: str, zone: ZoneInfo
) -> UnixTime:
    """When the next backup is due; not after ``now`` where it is to begin. ``newest``: when the newest was
    begun, None where there is none; ``failed``: when the last attempt was begun, None where it succeeded. A
    time in the future is of a clock that was wrong, and counts for nothing."""
    due = now if newest is None or newest > now else next_after(newest, at, zone)
    return due if failed is None or failed > now else max(due, failed + RETRY_S)


def name_of(at: UnixTime, zone: ZoneInfo) -> str:
    """The file of a backup that begins at this time: names of later ones come after it."""
    return f"lineside-{datetime.fromtimestamp(float(at), zone):%Y-%m-%d-%H%M%S}.tar"


def too_many(names: Iterable[str], keep: int, written: str) -> list[str]:
    """Those of the files of a folder that are backups, without the newest ``keep``. ``written``, the one that
    was written just now, is the newest: those of a later date are of a clock that was wrong, and older."""
    backups = sorted(
        (name for name in names if NAME.fullmatch(name) and name != written),
        key=lambda name: (name < written, name),
    )
    return backups[: max(0, len(backups) - keep + 1)]

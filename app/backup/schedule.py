"""When a backup is due, and which files are too many. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import datetime, time, timedelta
from zoneinfo import ZoneInfo

from bus.instants import UnixTime

NAME = re.compile(r"lineside-\d{4}-\d{2}-\d{2}-\d{6}\.tar")


def next_after(now: UnixTime, at: str, zone: ZoneInfo) -> UnixTime:
    """The next moment after ``now`` at which the clock of the zone shows ``at``; on a day without it, the
    moment at which it would."""
    local = datetime.fromtimestamp(float(now), zone)
    due = datetime.combine(local.date(), time.fromisoformat(at), zone)
    while due.timestamp() <= float(now):
        due = datetime.combine(due.date() + timedelta(days=1), due.time(), zone)
    return UnixTime(due.timestamp())


def name_of(at: UnixTime, zone: ZoneInfo) -> str:
    """The file of a backup that begins at this time: names of later ones come after it."""
    return f"lineside-{datetime.fromtimestamp(float(at), zone):%Y-%m-%d-%H%M%S}.tar"


def too_many(names: Iterable[str], keep: int) -> list[str]:
    """Those of the files of a folder that are backups, without the newest ``keep``."""
    backups = sorted(name for name in names if NAME.fullmatch(name))
    return backups[:-keep]

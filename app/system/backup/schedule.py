"""The schedule of backups: when one is due, how it is named, and which are too many. Pure. The clock may have
been set by a year, in either direction, since any of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from datetime import UTC, datetime, time, timedelta, tzinfo
from zoneinfo import ZoneInfo

from app.system.backup.settings import BackupSettings
from bus.instants import UnixTime

FORMAT = "lineside-%Y%m%dT%H%M%SZ.json"
"""The manifest of a backup, named by UTC."""
ARCHIVE = re.compile(r"lineside-(\d{4}-\d{2}-\d{2}-\d{6})\.tar")
"""A backup of version 0.2, named by the clock of the site."""
RETRY_S = 3600.0
"""After one that failed, or sooner where backups are more frequent."""
HOUR_S, DAY_S = 3600.0, 86_400.0
ALL_S = 2 * HOUR_S
"""Of so long every backup is kept; then of a day one per hour, of ``keep`` days one per day, then one per
month."""
MONTHS = 12


def next_after(now: UnixTime, at: str, zone: ZoneInfo) -> UnixTime:
    """Return the next moment after ``now`` at which the clock of the zone shows ``at``; on a day without it,
    the moment at which it would."""
    local = datetime.fromtimestamp(float(now), zone)
    due = datetime.combine(local.date(), time.fromisoformat(at), zone)
    while due.timestamp() <= float(now):
        due = datetime.combine(due.date() + timedelta(days=1), due.time(), zone)
    return UnixTime(due.timestamp())


def next_due(
    now: UnixTime, newest: UnixTime | None, failed: UnixTime | None, settings: BackupSettings, zone: ZoneInfo
) -> UnixTime:
    """Return when the next backup is due; not after ``now`` where it is to begin. ``newest``: when the newest
    was begun, None where there is none; ``failed``: when the last attempt was begun, None where it succeeded.
    A time in the future is of a clock that was wrong, and counts for nothing."""
    every = settings.every_s
    if newest is None or newest > now:
        due = now
    else:
        due = next_after(newest, settings.at, zone) if every is None else newest + every
    retry_s = RETRY_S if every is None else min(RETRY_S, every)
    return due if failed is None or failed > now else max(due, failed + retry_s)


def name_of(at: UnixTime) -> str:
    """Return the manifest of a backup that begins at this time: names of later ones come after it."""
    return datetime.fromtimestamp(float(at), UTC).strftime(FORMAT)


def time_of(name: str, zone: tzinfo = UTC) -> UnixTime | None:
    """Return when a backup was begun, by its name; None for another file."""
    try:
        if (archive := ARCHIVE.fullmatch(name)) is not None:
            local = datetime.strptime(archive[1], "%Y-%m-%d-%H%M%S").replace(tzinfo=zone)
        else:
            local = datetime.strptime(name, FORMAT).replace(tzinfo=UTC)
    except ValueError:
        return None
    return UnixTime(local.timestamp())


def too_many(names: Iterable[str], keep: int, written: str, zone: ZoneInfo) -> list[str]:
    """Return those of the files of a folder that are backups and not kept. ``written``, the one that was
    written just now, is the newest: those of a later date are of a clock that was wrong."""
    times = {name: at for name in names if (at := time_of(name, zone)) is not None}
    now = times[written]
    past = sorted((name for name, at in times.items() if at <= now), key=times.__getitem__, reverse=True)

    def first_of(key: Callable[[datetime], tuple[int, ...]], most: int) -> set[str]:
        """Return the newest backup of each of the newest so many periods."""
        found: dict[tuple[int, ...], str] = {}
        for name in past:
            found.setdefault(key(datetime.fromtimestamp(float(times[name]), zone)), name)
        return {*[*found.values()][:most]}

    kept = {name for name in past if now - times[name] <= ALL_S} | {written}
    hourly = first_of(lambda local: (local.toordinal(), local.hour), 10**6)
    kept |= {name for name in hourly if now - times[name] <= DAY_S}
    kept |= first_of(lambda local: (local.toordinal(),), keep)
    kept |= first_of(lambda local: (local.year, local.month), MONTHS)
    return sorted(times.keys() - kept)

"""The time zone of the machine, by a name that a browser understands too."""

from __future__ import annotations

import os
from datetime import datetime, time, timedelta
from functools import cache
from pathlib import Path
from zoneinfo import ZoneInfo

from babel.localtime import get_localzone

from bus.instants import UnixTime

UTC = "UTC"
LOCALTIME = Path("/etc/localtime")
_FOLDER = "/zoneinfo/"
_SAME_ZONES = "posix/"
"""A folder with every zone a second time."""
_NOT_IANA = frozenset({"", "localtime", "posixrules", "Factory"})
"""Files of a zoneinfo folder that are no zones of the IANA list: browsers refuse their names."""


@cache
def machine_zone() -> str:
    """Return the IANA name of the zone that the machine is set to (TZ, /etc/localtime, /etc/timezone); UTC
    where it has none that is in the list, such as a TZ of POSIX rules. Read once: a server keeps its zone."""
    try:
        name = getattr(get_localzone(), "key", None)
        if name is None:
            # The name of a zone by where its file is: …/zoneinfo/Europe/Berlin.
            file = Path(os.environ.get("TZ", "").removeprefix(":") or LOCALTIME)
            name = str(file.resolve()).partition(_FOLDER)[2]
    except (LookupError, ValueError, OSError):
        return UTC
    name = name.removeprefix(_SAME_ZONES)
    return name if is_zone(name) else UTC


def is_zone(name: str) -> bool:
    """Return whether a name is in the IANA list, as far as this machine has it."""
    try:
        return name not in _NOT_IANA and ZoneInfo(name).key == name
    except (LookupError, ValueError, OSError):
        return False


def day_begins(text: str, zone: str, later: timedelta = timedelta(0)) -> UnixTime | None:
    """Return the instant at which a day (2026-11-21) begins at the site; None for an invalid day."""
    try:
        day = datetime.fromisoformat(text).date() + later
        return UnixTime(datetime.combine(day, time(), ZoneInfo(zone)).timestamp())
    except (ValueError, OverflowError):
        return None

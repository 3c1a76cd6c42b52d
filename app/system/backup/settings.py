"""The table ``[backup]`` of the configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from bus.settings import StrictModel

CLOCK = r"^([01]\d|2[0-3]):[0-5]\d$"
INTERVAL = r"^([1-9]|[1-5]\d) min$|^([1-9]|1\d|2[0-4]) h$"


class BackupSettings(StrictModel):
    """The folder, the times and the extent of this server's backups."""

    folder: Path | None = None
    """The folder for the backups of this site, best on another computer; relative to the configuration,
    absolute once loaded. None: no backups."""
    at: Annotated[str, Field(pattern=CLOCK)] = "02:30"
    """The time of the daily backup by the clock of the site, if ``every`` is not set."""
    every: Annotated[str, Field(pattern=INTERVAL)] | None = None
    """The interval of backups, such as ``"10 min"`` or ``"1 h"``."""
    keep: Annotated[int, Field(strict=True, ge=1, le=1000)] = 14
    """The days of which the last backup is kept, besides all of the last two hours, one per hour of a day,
    and one per month of a year."""
    key_file: Path | None = None
    """A key file that encrypts the secret files of a backup, which otherwise lacks them. Relative to the
    configuration, absolute once loaded; not made by Lineside."""

    @property
    def every_s(self) -> float | None:
        """The seconds between two backups; None: once a day."""
        if self.every is None:
            return None
        number, unit = self.every.split()
        return int(number) * (60.0 if unit == "min" else 3600.0)

"""The table ``[audit]`` of lineside.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from bus.settings import StrictModel


class Audit(StrictModel):
    """The files that make the audit log provable, relative to the configuration; absolute once loaded."""

    key_file: Path | None = None
    """The keys that seal the log, made at the first start; by default as in `Settings.key_files`."""
    anchor: Path | None = None
    """The file in which the head of the log is noted every minute and at every stop; by default the newest
    one is kept beside the key."""
    archive: Path | None = None
    """The folder to which old events are moved, a file for each month, best on another disk. None: all events
    stay in the store."""
    keep_months: Annotated[int, Field(strict=True, ge=1, le=1200)] = 24
    """The complete months before the current one that stay in the store, if there is an archive."""

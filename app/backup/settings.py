"""The table ``[backup]`` of the configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from bus.settings import StrictModel

CLOCK = r"^([01]\d|2[0-3]):[0-5]\d$"


class BackupSettings(StrictModel):
    """Whether, where and when this server backs itself up."""

    folder: Path | None = None
    """Where the files are written, best on another disk; relative to the configuration, absolute once loaded.
    None: there is no backup."""
    at: Annotated[str, Field(pattern=CLOCK)] = "02:30"
    """By the clock of the site."""
    keep: Annotated[int, Field(strict=True, ge=1, le=1000)] = 14
    """So many files; the oldest is deleted once another is written."""
    key_file: Path | None = None
    """Encrypts the secret files of a backup, which else are not in it. Relative to the configuration,
    absolute once loaded; not made by Lineside."""

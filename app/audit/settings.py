"""``[audit]`` of lineside.toml."""

from __future__ import annotations

from pathlib import Path

from bus.settings import StrictModel


class Audit(StrictModel):
    """The files that make the audit log provable, relative to the configuration; absolute once loaded."""

    key_file: Path | None = None
    """The keys that seal the log, made at the first start; when absent, see `Settings.key_files`."""
    anchor: Path | None = None
    """Where the head of the log is noted every minute and at every stop; when absent, see
    `Settings.anchor_file`."""

"""Backups in one file, for the tests of what is in them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from app.cli.backup_store import Restored, put_back
from app.system.backup.archive import WrittenBackup, open_archive, write_archive


def write_backup(data: Path, file: Path) -> WrittenBackup:
    """Back up the stores of a data folder alone."""
    return write_archive(data, file, None, None)


def read_backup(file: Path, data: Path, key_files: Sequence[Path]) -> Restored:
    """Put the stores of a backup into a data folder."""
    with open_archive(file) as backup:
        return put_back(backup, data, key_files)

"""Whether a nightly backup can be written from this machine."""

from __future__ import annotations

from collections.abc import Iterator

from app.backup.settings import BackupSettings
from app.cli.backup_cipher import read_key
from app.cli.findings import Finding, fault, may_make_files_in, user
from app.errors import StoreError
from bus.messages import Message


def backup_findings(settings: BackupSettings) -> Iterator[Finding]:
    """The folder of the backups, and their key."""
    if settings.key_file is not None:
        try:
            read_key(settings.key_file)
        except StoreError as error:
            yield fault("check_backup_key_refused", reason=error.message)
    if settings.folder is None:
        return
    folder = str(settings.folder)
    if not settings.folder.is_dir():
        yield fault("check_backup_folder_missing", folder=folder)
    elif not may_make_files_in(settings.folder):
        yield fault("check_backup_folder_not_writable", user=user(), folder=folder)
    else:
        yield Finding(Message.of("check_backup", folder=folder, at=settings.at))

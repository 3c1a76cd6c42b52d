"""Whether a backup can be written from this machine."""

from __future__ import annotations

from collections.abc import Iterator

from app.cli.findings.machine import Finding, fault, is_read_only, may_make_files_in, user
from app.core.database.files import free_bytes
from app.errors import StoreError
from app.settings import Settings
from app.system.backup.files import read_key
from app.system.backup.folder import refuse_other_site, space_needed
from bus.messages import Message

MB = 1_000_000


def backup_findings(site: Settings) -> Iterator[Finding]:
    """The folder of the backups, its disk, and their key."""
    settings = site.backup
    if settings.key_file is not None:
        try:
            read_key(settings.key_file)
        except StoreError as error:
            yield fault("check_backup_key_refused", reason=error.message)
    if settings.folder is None:
        return
    if (found := folder_fault(site)) is not None:
        yield Finding(found, is_fault=True)
    elif settings.every is not None:
        yield Finding(Message.of("check_backup_every", folder=str(settings.folder), every=settings.every))
    else:
        yield Finding(Message.of("check_backup", folder=str(settings.folder), at=settings.at))


def folder_fault(site: Settings) -> Message | None:
    """What keeps a backup from being written into the folder of ``[backup]``; None: nothing."""
    folder = site.backup.folder
    if folder is None:
        return None
    if not folder.is_dir():
        return Message.of("check_backup_folder_missing", folder=str(folder))
    if is_read_only(folder):
        return Message.of("check_disk_read_only", path=str(folder))
    needed, free = space_needed(site, folder), free_bytes(folder)
    if needed > free:
        return Message.of(
            "check_backup_disk_full", folder=str(folder), needed=-(-needed // MB), free=free // MB
        )
    if not may_make_files_in(folder):
        return Message.of("check_backup_folder_not_writable", user=user(), folder=str(folder))
    if site.server.store.exists():
        try:
            refuse_other_site(folder, site.server.store)
        except StoreError as error:
            return error.message
    return None

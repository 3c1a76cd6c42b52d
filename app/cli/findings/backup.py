"""Whether a nightly backup can be written from this machine."""

from __future__ import annotations

from collections.abc import Iterator

from app.cli.findings.machine import Finding, fault, is_read_only, may_make_files_in, user
from app.cli.stores.backup_cipher import read_key
from app.cli.stores.backup_store import space_needed
from app.cli.stores.kept_events import FOLDER
from app.database.reserve import free_bytes
from app.errors import StoreError
from app.settings import Settings
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
    folder = str(settings.folder)
    if not settings.folder.is_dir():
        yield fault("check_backup_folder_missing", folder=folder)
    elif is_read_only(settings.folder):
        yield fault("check_disk_read_only", path=folder)
    elif (needed := space_needed(site.server.data, site.audit.archive, settings.folder / FOLDER)) > (
        free := free_bytes(settings.folder)
    ):
        yield fault("check_backup_disk_full", folder=folder, needed=-(-needed // MB), free=free // MB)
    elif not may_make_files_in(settings.folder):
        yield fault("check_backup_folder_not_writable", user=user(), folder=folder)
    else:
        yield Finding(Message.of("check_backup", folder=folder, at=settings.at))

"""The archived events of many backups, each file once in a folder beside them, under its SHA-256.

They never change, so a backup refers to them by hash. That needs no links, which a share or a stick may not
have and a copy to another machine multiplies; and a damaged file that is copied again is sound for every
backup.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import stat
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from app.audit.archive import digest_of
from app.database.private import FILE_MODE, make_folder, refuse_link, sync_folder

FOLDER = "archived-events"
"""The name of the folder."""
_NAME = re.compile(r"[0-9a-f]{64}\.jsonl\.gz")


def kept_file(folder: Path, digest: str) -> Path:
    """Where a file of this SHA-256 is kept."""
    return folder / f"{digest}.jsonl.gz"


def is_kept(folder: Path, digest: str) -> bool:
    """Whether the folder has the file, as it was written. A FIFO or a link in its place is not read."""
    place = kept_file(folder, digest)
    try:
        return stat.S_ISREG(place.lstat().st_mode) and digest_of(place) == digest
    except OSError:
        return False


def keep(sources: Mapping[str, Path], folder: Path) -> None:
    """Copy the files, by their SHA-256, that the folder has not or has damaged. Raises OSError."""
    for digest, source in sources.items():
        if not is_kept(folder, digest):
            fresh = folder / f".{digest}"
            fresh.unlink(missing_ok=True)
            copy_file(source, fresh)
            fresh.rename(kept_file(folder, digest))
    sync_folder(folder)


def copy_file(source: Path, place: Path) -> None:
    """Copy a file to where none is, for this user alone; on disk when this returns. Raises OSError."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    with source.open("rb") as content, os.fdopen(os.open(place, flags, FILE_MODE), "wb") as target:
        shutil.copyfileobj(content, target)
        target.flush()
        os.fsync(target.fileno())


def remove_others(folder: Path, referred: Collection[str]) -> None:
    """Delete the files to which no backup refers: all but those of these SHA-256."""
    names = {kept_file(folder, digest).name for digest in referred}
    for path in folder.iterdir():
        if _NAME.fullmatch(path.name) and path.name not in names:
            path.unlink()


@contextmanager
def shared_folder(beside: Path) -> Iterator[Path]:
    """The folder beside a backup, made where it is missing; for one backup at a time, as another could remove
    what this one is about to refer to."""
    folder = beside / FOLDER
    refuse_link(folder)
    make_folder(folder)
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield folder
    finally:
        os.close(descriptor)

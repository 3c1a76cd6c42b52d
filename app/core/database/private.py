"""Files and folders for the server's user alone. Links, which others may have made, are never followed."""

from __future__ import annotations

import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import structlog

from app.core.database.words import in_words
from app.errors import StoreError
from bus.messages import Message

FOLDER_MODE, FILE_MODE = 0o700, 0o600
OTHERS = 0o077
"""Every right of the group and of others."""
WRITABLE_BY_OTHERS = 0o022
CODE = "compiled"
"""The folder of compiled templates, which are executed: it is emptied if others could have written to it."""

log = structlog.get_logger()


def make_folder(path: Path) -> None:
    """A folder that only its user can enter; one that is there is left as it is."""
    path.mkdir(FOLDER_MODE, parents=True, exist_ok=True)


def make_file(path: Path) -> None:
    """An empty file that only its user can read, where there is none. Raises StoreError for a link.

    A file that is there is not opened: closing a store would end the locks that SQLite holds on it.
    """
    refuse_link(path)
    try:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, FILE_MODE))
    except FileExistsError:
        return


def write_file(path: Path, content: bytes) -> None:
    """Replace a file, all of it or nothing; on disk when this returns. A link in its place is replaced, not
    followed."""
    with fresh_file(path, content) as fresh:
        fresh.replace(path)
    sync_folder(path.parent)


@contextmanager
def fresh_file(path: Path, content: bytes) -> Iterator[Path]:
    """A new file beside ``path``, on disk; it is removed where it has not been renamed."""
    fresh = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, FILE_MODE)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(descriptor)
        yield fresh
    finally:
        fresh.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Sync a folder, so that a power failure cannot remove the name of a new file in it."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def refuse_link(path: Path) -> None:
    """Raises StoreError where the file is a link."""
    if path.is_symlink():
        raise StoreError(Message.of("file_is_link", path=str(path)))


def make_private(folder: Path) -> None:
    """Take the rights of all others from a folder and everything in it.

    Raises StoreError for files of another owner, who could give them back.
    """
    with in_words(folder):
        make_folder(folder)
        # From the top down: once a folder is restricted, no other user can put a link where a file was.
        was_open = restrict(folder) & WRITABLE_BY_OTHERS
        code = folder / CODE
        if code.is_dir() and not code.is_symlink() and (was_open or _others_can_write(code)):
            shutil.rmtree(code)
        for path in _everything_in(folder):
            # Another process may be at work here, and have removed it meanwhile.
            with suppress(FileNotFoundError):
                restrict(path)


def restrict(path: Path) -> int:
    """Take the rights of others from one file or folder; return the mode that it had. Raises StoreError."""
    found = path.lstat()
    if found.st_uid not in (os.geteuid(), 0):
        raise StoreError(Message.of("file_of_other_user", path=str(path), uid=found.st_uid))
    is_folder = stat.S_ISDIR(found.st_mode)
    # A file with a second name may belong elsewhere, and a link always does.
    is_ours_alone = is_folder or (stat.S_ISREG(found.st_mode) and found.st_nlink == 1)
    if found.st_mode & OTHERS and is_ours_alone:
        try:
            path.chmod(FOLDER_MODE if is_folder else FILE_MODE)
        except PermissionError:
            log.warning("others can use this, and only root can change that", path=str(path))
    return found.st_mode


def _everything_in(folder: Path) -> Iterator[Path]:
    for parent, folders, files in os.walk(folder, followlinks=False):
        yield from (Path(parent, name) for name in (*folders, *files))


def _others_can_write(folder: Path) -> bool:
    return any(path.lstat().st_mode & WRITABLE_BY_OTHERS for path in (folder, *_everything_in(folder)))

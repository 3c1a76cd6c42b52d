"""Files of the data folder: for the server's user alone, with their failures in words, and the disk space
that is kept for commands. Links, which other users may have made, are never followed."""

from __future__ import annotations

import os
import secrets
import shutil
import sqlite3
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import structlog

from app.errors import ConstraintError, DamagedStoreError, StoreError, TooCostlyError, system_error
from bus.errors import CallerError
from bus.messages import Message

_MEANINGS: dict[int, Message] = {
    sqlite3.SQLITE_FULL: Message("store_disk_full"),
    sqlite3.SQLITE_READONLY: Message("store_read_only"),
    sqlite3.SQLITE_CORRUPT: Message("store_is_damaged"),
    sqlite3.SQLITE_NOTADB: Message("store_foreign"),
    sqlite3.SQLITE_CANTOPEN: Message("store_not_openable"),
    sqlite3.SQLITE_IOERR: Message("store_disk_failed"),
    sqlite3.SQLITE_BUSY: Message("store_locked"),
    sqlite3.SQLITE_PERM: Message("store_access_refused"),
}
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
FOLDER_MODE, FILE_MODE = 0o700, 0o600
OTHERS = 0o077
"""The mode bits of every right of the group and of others."""
WRITABLE_BY_OTHERS = 0o022
CODE = "compiled"
"""The folder of compiled templates, which are executed: it is emptied if others could have written there."""
log = structlog.get_logger()
FILE = "reserve"
SIZE = 64_000_000
"""The bytes for a day with a command each 4 s: one with its result takes 2.6 kB."""
MIN_FREE = 2_000_000
"""The bytes free before a transaction: for its rows, the store's write-ahead log and the checkpoint."""
MIN_FREE_OF_OTHERS = 100_000_000
"""The free bytes below which only the main store is written: neither readings nor pictures."""


@contextmanager
def in_words(path: Path) -> Iterator[None]:
    """Turn what SQLite or the file system raises into a StoreError that names the store.

    A broken rule of a table raises ConstraintError, which the caller handles; a number past 64 bits, which
    can only come from a request, raises CallerError.
    """
    try:
        yield
    except sqlite3.IntegrityError as error:
        raise ConstraintError(Message.of("store_rule_broken", path=str(path), error=str(error))) from error
    except OverflowError as error:
        raise CallerError(Message("number_too_large")) from error
    except sqlite3.Error as error:
        # The low byte of an extended result code is the primary one.
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code == sqlite3.SQLITE_INTERRUPT:
            raise TooCostlyError(Message("search_too_costly")) from error
        reason = _MEANINGS.get(code) or system_error(error)
        kind = DamagedStoreError if code in _DAMAGED else StoreError
        raise kind(Message.of("store_failed", path=str(path), reason=reason)) from error
    except OSError as error:
        failed = Message.of("store_folder_failed", path=str(path), error=system_error(error))
        raise StoreError(failed) from error


def make_folder(path: Path) -> None:
    """Make a folder that only its user can enter; one that exists is left as it is."""
    path.mkdir(FOLDER_MODE, parents=True, exist_ok=True)


def make_file(path: Path) -> None:
    """Make an empty file that only its user can read, unless it exists. Raise StoreError for a link.

    An existing file is not opened: closing a store would end the locks that SQLite holds on it.
    """
    refuse_link(path)
    try:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, FILE_MODE))
    except FileExistsError:
        return


def write_file(path: Path, content: bytes) -> None:
    """Replace a file, completely or not at all; it is on disk when this returns. A link in its place is
    replaced, not followed."""
    with fresh_file(path, content) as fresh:
        fresh.replace(path)
    sync_folder(path.parent)


@contextmanager
def fresh_file(path: Path, content: bytes) -> Iterator[Path]:
    """Write a new file beside ``path``; on leaving the context it is removed unless it was renamed."""
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
    """Raise StoreError if the file is a link."""
    if path.is_symlink():
        raise StoreError(Message.of("file_is_link", path=str(path)))


def make_private(folder: Path) -> None:
    """Take the rights of other users from a folder and everything in it.

    Raise StoreError for files of another owner, who could give them back.
    """
    with in_words(folder):
        make_folder(folder)
        # It goes from the top down: once a folder is restricted, no other user can put a link where a file
        # was.
        was_open = restrict(folder) & WRITABLE_BY_OTHERS
        code = folder / CODE
        if code.is_dir() and not code.is_symlink() and (was_open or _others_can_write(code)):
            shutil.rmtree(code)
        for path in _everything_in(folder):
            # Another process may be at work here, and have removed it meanwhile.
            with suppress(FileNotFoundError):
                restrict(path)


def restrict(path: Path) -> int:
    """Take the rights of other users from one file or folder; return the mode that it had."""
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


def free_bytes(folder: Path) -> int:
    """Return the bytes that this user may still write on the disk of a folder."""
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize


class Reserve:
    """The disk space that is kept for commands: they are still recorded, and sent, on a full disk.

    A file takes the space while there is enough. Before each transaction of the main store it gives up what
    the transaction may need; all other stores stop earlier, at `MIN_FREE_OF_OTHERS`. Only the thread that
    writes the main store uses it; `left` may be read by any.
    """

    def __init__(self, folder: Path, size: int = SIZE) -> None:
        make_folder(folder)
        self._path = folder / FILE
        self._size = size
        self._to_make = True
        free, held = free_bytes(folder), self._held()
        self._make(held, min(size, (free + held) // 2))
        self._note(free, self._held())

    def keep(self) -> None:
        """Make room for a transaction, or take the space back if the disk has it. If the disk fails, the
        transaction gets its own error."""
        with suppress(OSError):
            free, held = free_bytes(self._path.parent), self._held()
            if free < MIN_FREE and held:
                os.truncate(self._path, max(0, held - MIN_FREE + free))
                held = self._held()
            elif held < self._size and free >= MIN_FREE_OF_OTHERS + self._size - held:
                self._make(held, self._size)
                held = self._held()
            self._note(free, held)

    @property
    def notice(self) -> Message | None:
        """Return the notice that a disk is short of space while some of the reserve is used up or was never
        there; else None."""
        if self.left == 1.0 or not self._is_short:
            return None
        return Message.of("reserve_in_use", percent=round(100 * self.left))

    def close(self) -> None:
        """Give the space back, unless the disk is short: then the next start needs it."""
        with suppress(OSError):
            if free_bytes(self._path.parent) >= MIN_FREE_OF_OTHERS:
                self._path.unlink(missing_ok=True)

    def _make(self, held: int, size: int) -> None:
        """Allocate the missing part of ``size``; a file with holes would hold no space."""
        if held >= size or not self._to_make:
            return
        try:
            make_file(self._path)
            with self._path.open("r+b") as file:
                os.posix_fallocate(file.fileno(), held, size - held)
        except (OSError, StoreError) as error:
            log.warning("no disk reserve; on a full disk no command is sent", error=str(error))
            self._to_make = False
            with suppress(OSError):
                os.truncate(self._path, held)

    def _held(self) -> int:
        try:
            return self._path.lstat().st_size
        except FileNotFoundError:
            return 0

    def _note(self, free: int, held: int) -> None:
        self._is_short = free < MIN_FREE_OF_OTHERS
        self.left = held / self._size
        """The part of the space that is still there, 0 to 1."""

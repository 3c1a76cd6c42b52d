"""What SQLite's failures mean to a person."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from app.errors import DamagedStoreError, StoreError, TooCostlyError
from bus.errors import CallerError
from bus.messages import Message

__all__ = ["StoreError", "in_words"]

_MEANINGS: dict[int, str] = {
    sqlite3.SQLITE_FULL: "the disk is full; nothing was stored; free some space",
    sqlite3.SQLITE_READONLY: "it is read-only; give the server's user write access to it and its folder",
    sqlite3.SQLITE_CORRUPT: ("it is damaged; restore a backup (lineside restore-store) or move it away"),
    sqlite3.SQLITE_NOTADB: ("it is not a Lineside store, or it is damaged; restore a backup or move it away"),
    sqlite3.SQLITE_CANTOPEN: "it cannot be opened; check that its folder exists and is accessible",
    sqlite3.SQLITE_IOERR: "disk error; check the disk",
    sqlite3.SQLITE_BUSY: "another program has locked it; stop that program",
    sqlite3.SQLITE_PERM: "access to it is refused; give the server's user access",
}
_PRIMARY = 0xFF
"""An extended result code holds the primary one in its low byte."""


@contextmanager
def in_words(path: Path) -> Iterator[None]:
    """Turn what SQLite or the file system raises into a StoreError that names the store.

    A broken rule of a table (sqlite3.IntegrityError) passes through: that is for the caller to answer.
    A number past 64 bits can only have been asked for: CallerError.
    """
    try:
        yield
    except sqlite3.IntegrityError:
        raise
    except OverflowError as error:
        raise CallerError(Message("number_too_large")) from error
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", None)
        if code == sqlite3.SQLITE_INTERRUPT:
            raise TooCostlyError(Message("search_too_costly")) from error
        meaning = _MEANINGS.get(code & _PRIMARY) if isinstance(code, int) else None
        damaged = isinstance(code, int) and code & _PRIMARY == sqlite3.SQLITE_CORRUPT
        kind = DamagedStoreError if damaged else StoreError
        raise kind(f"the store {path}: {meaning or error}") from error
    except OSError as error:
        raise StoreError(
            Message.of("store_folder_failed", path=str(path), error=error.strerror or str(error))
        ) from error

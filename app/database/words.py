"""What SQLite's failures mean to a person."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from app.errors import DamagedStoreError, StoreError, TooCostlyError, system_error
from bus.errors import CallerError
from bus.messages import Message

__all__ = ["StoreError", "in_words"]

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
        raise kind(
            Message.of("store_failed", path=str(path), reason=meaning or system_error(error))
        ) from error
    except OSError as error:
        failed = Message.of("store_folder_failed", path=str(path), error=system_error(error))
        raise StoreError(failed) from error

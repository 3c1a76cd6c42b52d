"""Turns failures of SQLite into messages for people."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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


@contextmanager
def in_words(path: Path) -> Iterator[None]:
    """Turn what SQLite or the file system raises into a StoreError that names the store.

    A broken rule of a table is the caller's to handle: ConstraintError. A number past 64 bits can only come
    from a request: CallerError.
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

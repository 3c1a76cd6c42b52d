"""The file of the local log: each line is on disk before what it logs is done."""

from __future__ import annotations

import os
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from app.audit.local_log.transaction import LoggedTransaction, ReadLog, read_lines, sealed_line
from app.audit.proof.keyring import BEGINNING, KeyRing
from app.database.private import FILE_MODE, refuse_link, sync_folder
from app.database.sqlite.reserve import Reserve
from app.errors import StoreError, system_error
from bus.instants import UnixTime
from bus.messages import Message

FILE = "local-log"
MAX_BYTES = 16_000_000
"""A quarter of the disk reserve. A command to one unit with its result takes 0.9 kB."""
MAX_BYTES_OF_OTHERS = 12_000_000
"""The rest is for commands that make a line slower or stop it, and for what people do."""
MAX_READ_BYTES = 2 * MAX_BYTES


class LocalFile:
    """Used by one thread at a time. ``reserve``: the disk space that it may use up."""

    def __init__(self, folder: Path, reserve: Reserve | None = None, max_bytes: int = MAX_BYTES) -> None:
        self.path = folder / FILE
        self._reserve = reserve
        self._max_bytes = max_bytes
        self._size = 0
        self._seal = BEGINNING
        self._descriptor: int | None = None

    def read(self, ring: KeyRing) -> ReadLog:
        """Read what the last run left; what is added later follows it. Raises StoreError."""
        refuse_link(self.path)
        try:
            with self.path.open("rb") as file:
                content = file.read(MAX_READ_BYTES)
        except FileNotFoundError:
            return ReadLog()
        except OSError as error:
            raise self._failed(error) from error
        found = read_lines(content, ring)
        self._size, self._seal = found.end, found.seal
        return found

    def append(self, transaction: LoggedTransaction, ring: KeyRing, *, is_urgent: bool) -> None:
        """Add a transaction; it is on disk when this returns. Raises StoreError where it is not: the file is
        full, for all that is not urgent a little earlier, or the disk fails."""
        line, seal = sealed_line(transaction, self._seal, ring)
        limit = self._max_bytes if is_urgent else self._max_bytes * MAX_BYTES_OF_OTHERS // MAX_BYTES
        if self._size + len(line) > limit:
            raise StoreError(Message.of("local_log_full", path=str(self.path), megabytes=limit // 1_000_000))
        if self._reserve is not None:
            self._reserve.keep()
        try:
            descriptor = self._opened()
            _write_all(descriptor, line)
            os.fdatasync(descriptor)
        except OSError as error:
            self._take_back()
            raise self._failed(error) from error
        self._size, self._seal = self._size + len(line), seal

    def clear(self) -> None:
        """Remove the file: all of it is in the database. Raises StoreError."""
        try:
            self._close()
            self.path.unlink(missing_ok=True)
            sync_folder(self.path.parent)
        except OSError as error:
            raise self._failed(error) from error
        self._size, self._seal = 0, BEGINNING

    def put_aside(self, now: UnixTime) -> Path:
        """Keep the file under another name, as evidence. Raises StoreError."""
        stamp = datetime.fromtimestamp(float(now), UTC).strftime("%Y%m%dT%H%M%S")
        aside = self.path.with_name(f"{FILE}.not-followed-{stamp}")
        try:
            self._close()
            self.path.rename(aside)
            sync_folder(self.path.parent)
        except OSError as error:
            raise self._failed(error) from error
        self._size, self._seal = 0, BEGINNING
        return aside

    def _opened(self) -> int:
        """The file, cut off where its last good line ends."""
        if self._descriptor is None:
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
            self._descriptor = os.open(self.path, flags, FILE_MODE)
            os.ftruncate(self._descriptor, self._size)
            sync_folder(self.path.parent)
        return self._descriptor

    def _take_back(self) -> None:
        """A part of a line must not come before the next one."""
        with suppress(OSError):
            if self._descriptor is not None:
                os.ftruncate(self._descriptor, self._size)
        self._close()

    def _close(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def _failed(self, error: OSError) -> StoreError:
        return StoreError(Message.of("local_log_failed", path=str(self.path), error=system_error(error)))


def _write_all(descriptor: int, line: bytes) -> None:
    while line:
        line = line[os.write(descriptor, line) :]

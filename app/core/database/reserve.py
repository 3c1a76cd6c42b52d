"""Disk space that is kept for commands: on a full disk they are still recorded, before they are sent.

A file takes the space while there is enough. Before each transaction of the main store it gives up what that
may need; all other stores stop earlier, at `MIN_FREE_OF_OTHERS`.
"""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path

import structlog

from app.core.database.private import make_file, make_folder
from app.errors import StoreError
from bus.messages import Message

FILE = "reserve"
SIZE = 64_000_000
"""A day with a command each 4 s: one with its result takes 2.6 kB."""
MIN_FREE = 2_000_000
"""Free bytes before a transaction: its rows, the store's write-ahead log and the checkpoint of both."""
MIN_FREE_OF_OTHERS = 100_000_000
"""Free bytes below which only the main store is written: neither readings nor pictures."""

log = structlog.get_logger()


def free_bytes(folder: Path) -> int:
    """How many bytes this user may still write there."""
    return shutil.disk_usage(folder).free


class Reserve:
    """The space of one data folder. Used by the thread that writes the main store; `left` by any."""

    def __init__(self, folder: Path, size: int = SIZE) -> None:
        make_folder(folder)
        self._path = folder / FILE
        self._size = size
        self._to_make = True
        free, held = free_bytes(folder), self._held()
        self._make(held, min(size, (free + held) // 2))
        self._note(free)

    def keep(self) -> None:
        """Make room for a transaction, or take the space back where the disk has it. Where the disk fails,
        the transaction has its own error."""
        with suppress(OSError):
            free, held = free_bytes(self._path.parent), self._held()
            if free < MIN_FREE and held:
                os.truncate(self._path, max(0, held - MIN_FREE + free))
            elif free >= MIN_FREE_OF_OTHERS + self._size - held:
                self._make(held, self._size)
            self._note(free)

    @property
    def notice(self) -> Message | None:
        """That the space is used up, or was never there, on a disk that is short; None while it is not."""
        if self.left == 1.0 or not self._is_short:
            return None
        return Message.of("reserve_in_use", percent=round(100 * self.left))

    def close(self) -> None:
        """Give the space back, unless the disk is short: then the next start needs it."""
        with suppress(OSError):
            if free_bytes(self._path.parent) >= MIN_FREE_OF_OTHERS:
                self._path.unlink(missing_ok=True)

    def _make(self, held: int, size: int) -> None:
        """Really allocate what is missing of ``size``: a file with holes would hold nothing."""
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

    def _note(self, free: int) -> None:
        self._is_short = free < MIN_FREE_OF_OTHERS
        self.left = self._held() / self._size
        """The part of the space that is still there, 0 to 1."""

"""A file of the archive: each entry a line of JSON as the store had it, compressed with gzip.

It is written beside its place and put there once it is on disk and was read back.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import re
import secrets
import zlib
from collections.abc import Iterator, Mapping
from itertools import count
from pathlib import Path
from typing import Any, BinaryIO

from app.database.private import FILE_MODE, sync_folder
from app.errors import StoreError
from bus.messages import Message

Entry = dict[str, Any]
MAX_LINE = 1024 * 1024
"""Characters of an entry; the longest has a few hundred frames. A file that was put there in place of ours
may unpack to one line without an end."""
NAME = re.compile(r"events-\d{4}-\d{2}(-[1-9]\d*)?\.jsonl\.gz")


class EventArchiveError(StoreError):
    """A file of the archive cannot be written or read."""


class ArchiveWriter:
    """Writes one file; ``close`` puts it in its place, ``discard`` leaves nothing of it. Raises OSError."""

    def __init__(self, folder: Path, month: str) -> None:
        if not folder.is_dir():
            # It may be that of a disk that is not mounted: it is not made.
            raise EventArchiveError(Message.of("audit_archive_folder_missing", folder=str(folder)))
        self._folder, self._month = folder, month
        self._path = folder / f".events-{month}.{secrets.token_hex(4)}"
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        self._file: BinaryIO = os.fdopen(os.open(self._path, flags, FILE_MODE), "wb")
        # Without its time and name: the same entries are the same bytes.
        self._packed = gzip.GzipFile(filename="", mode="wb", fileobj=self._file, mtime=0)
        self.entries = 0

    def write(self, entries: list[Entry]) -> None:
        lines = (json.dumps({k: v for k, v in each.items() if v is not None}) for each in entries)
        self._packed.write("".join(f"{line}\n" for line in lines).encode())
        self.entries += len(entries)

    def close(self) -> tuple[str, str]:
        """Return the name of the file and its SHA-256, once it is on disk. One with the same content takes
        its place; no other one is ever replaced. Raises EventArchiveError."""
        self._packed.close()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        digest = digest_of(self._path)
        if sum(1 for _ in entries_in(self._path)) != self.entries:
            raise EventArchiveError(Message.of("audit_archive_not_read_back", file=str(self._path)))
        for path in (self._folder / name for name in _names(self._month)):
            if os.path.lexists(path) and not (path.is_file() and digest_of(path) == digest):
                continue
            self._path.replace(path)
            sync_folder(self._folder)
            return path.name, digest
        raise AssertionError

    def discard(self) -> None:
        self._file.close()
        self._path.unlink(missing_ok=True)


def _names(month: str) -> Iterator[str]:
    """A month has a second file where a store was restored from a backup, and went on otherwise."""
    yield f"events-{month}.jsonl.gz"
    for number in count(2):
        yield f"events-{month}-{number}.jsonl.gz"


def digest_of(path: Path) -> str:
    """SHA-256 of a file, in hex. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def entries_in(path: Path) -> Iterator[Entry]:
    """The entries of a file as the store had them, without what they are a part of. Raises EventArchiveError,
    OSError."""
    try:
        if not path.is_file():
            raise ValueError("no file")
        with gzip.open(path, "rt", encoding="utf-8") as lines:
            while line := lines.readline(MAX_LINE):
                yield _entry_of(line)
    except (EOFError, RecursionError, ValueError, zlib.error, gzip.BadGzipFile) as error:
        raise EventArchiveError(Message.of("audit_archive_unreadable", file=path.name)) from error


def _entry_of(line: str) -> Entry:
    entry = json.loads(line)
    if not isinstance(entry, Mapping) or not isinstance(entry.get("id"), int):
        raise ValueError("no entry")
    if any(isinstance(value, dict | list) for value in entry.values()):
        raise ValueError("no row of the store")
    return {name: value for name, value in entry.items() if name != "part_of"}

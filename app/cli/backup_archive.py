"""The archive of backup-store, read as a file that anyone may have forged: the known names alone, plain files
alone, every size checked before anything is read. No path of the archive is ever used.

`tarfile` reads the headers, one at a time, and writes nothing: extracting follows what an archive states, and
its filters are not in Python 3.11.2, which Debian 12 ships.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import tarfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BufferedReader
from pathlib import Path
from typing import Annotated

import msgspec

from app.database.private import FILE_MODE
from app.errors import StoreError
from app.handover.pictures import FILE as PICTURES
from app.history.service import FILE as HISTORY
from app.settings import STORE_FILE
from bus.errors import LinesideError
from bus.messages import Message, ParamValue

MANIFEST = "manifest.json"
STORES = (HISTORY, STORE_FILE, PICTURES)
"""In the order in which they are copied: a picture is stored before its note, so that each note of the copy
has its pictures."""
MAX_ARCHIVE_BYTES = 256 * 2**30
MAX_MANIFEST_BYTES = 65_536
MAX_HEADER_BYTES = 65_536
"""Of the extended header of a member: `tarfile` writes one of some 30 bytes for its time."""
MAX_PADDING_BYTES = 2**20
"""After the last member; GNU tar fills up records of at most 512 kB."""
_EXTENDED = frozenset(("mtime", "atime", "ctime", "size", "uid", "gid", "uname", "gname"))
"""What an extended header may state. It could also give another path, or holes."""
_RECORD = re.compile(rb"([0-9]{1,6}) ([a-z]+)=")
_BLOCK = tarfile.BLOCKSIZE
_CHUNK = 2**20
_Digest = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


class ArchiveError(LinesideError):
    """The archive is not one that backup-store writes, for a reason by its code."""

    def __init__(self, code: str, **params: ParamValue) -> None:
        super().__init__(Message(code, params))


class Manifest(msgspec.Struct):
    """``stores``: the SHA-256 of each by its name, hexadecimal; ``time``: Unix time of the backup."""

    time: Annotated[float, msgspec.Meta(ge=0, lt=2**37)]
    stores: Annotated[dict[str, _Digest], msgspec.Meta(min_length=1)]


@dataclass(frozen=True, slots=True)
class Extent:
    """Where the content of a member is, in bytes."""

    start: int
    size: int


@dataclass(frozen=True, slots=True)
class BackupArchive:
    """An open backup whose members and manifest are as they should be; the stores are not read yet."""

    file: BufferedReader
    path: Path
    stores: Mapping[str, Extent]
    manifest: Manifest

    @property
    def message(self) -> Message:
        """Its file, when it was taken and its SHA-256, hexadecimal."""
        taken = datetime.fromtimestamp(self.manifest.time, UTC).isoformat(timespec="seconds")
        self.file.seek(0)
        digest = hashlib.file_digest(self.file, "sha256").hexdigest()
        return Message.of("backup_of", file=self.path.name, time=taken, digest=digest)

    def unpack(self, folder: Path) -> list[Path]:
        """Write the stores into an empty folder; each is what was backed up. Raises StoreError."""
        needed, free = sum(extent.size for extent in self.stores.values()), free_bytes(folder)
        if needed > free:
            raise StoreError(Message.of("backup_needs_space", file=str(self.path), needed=needed, free=free))
        return [self._unpack_one(name, folder / name) for name in sorted(self.stores)]

    def _unpack_one(self, name: str, place: Path) -> Path:
        digest, flags = hashlib.sha256(), os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        with os.fdopen(os.open(place, flags, FILE_MODE), "wb") as target:
            for chunk in _chunks(self.file, self.stores[name]):
                digest.update(chunk)
                target.write(chunk)
        if digest.hexdigest() != self.manifest.stores[name]:
            raise StoreError(Message.of("backup_damaged", file=str(self.path), store=name))
        return place


@contextmanager
def open_archive(path: Path) -> Iterator[BackupArchive]:
    """Open a backup. Raises StoreError for a file that is none."""
    # A FIFO would be waited for.
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as file:
        try:
            yield _read(file, path)
        except ArchiveError as error:
            raise StoreError(Message.of("backup_malformed", file=str(path), error=error.message)) from error


def free_bytes(folder: Path) -> int:
    """What the disk of a folder can still take."""
    return shutil.disk_usage(folder).free


def _read(file: BufferedReader, path: Path) -> BackupArchive:
    found = os.fstat(file.fileno())
    if not stat.S_ISREG(found.st_mode):
        raise ArchiveError("archive_not_regular")
    if found.st_size > MAX_ARCHIVE_BYTES:
        raise ArchiveError("archive_too_large", most=MAX_ARCHIVE_BYTES)
    members = _members(file, found.st_size)
    manifest = _manifest(file, members.pop(MANIFEST, None))
    if manifest.stores.keys() != members.keys():
        raise ArchiveError("archive_manifest_differs")
    return BackupArchive(file, path, members, manifest)


def _members(file: BufferedReader, size: int) -> dict[str, Extent]:
    """By name where each member is, none beyond the end of the file, which is ``size``."""
    members: dict[str, Extent] = {}
    at = 0
    while any(header := _read_at(file, at, _BLOCK, size)):
        name, extent = _member(file, header, at, size)
        if name in members:
            raise ArchiveError("archive_holds_twice", name=name)
        members[name] = extent
        at = _next_block(extent)
    if size - at > MAX_PADDING_BYTES:
        raise ArchiveError("archive_goes_on")
    return members


def _member(file: BufferedReader, header: bytes, at: int, size: int) -> tuple[str, Extent]:
    """The member whose first header is at ``at``; it may have an extended one before its own."""
    info, stated_size = _parsed(header), None
    if info.type == tarfile.XHDTYPE:
        extended = Extent(at + _BLOCK, info.size)
        if not 0 <= info.size <= MAX_HEADER_BYTES:
            raise ArchiveError("archive_header_too_large")
        stated_size = _stated_size(_read_at(file, extended.start, extended.size, size))
        at = _next_block(extended)
        info = _parsed(_read_at(file, at, _BLOCK, size))
    if info.type not in (tarfile.REGTYPE, tarfile.AREGTYPE) or info.name not in (MANIFEST, *STORES):
        raise ArchiveError("archive_foreign")
    extent = Extent(at + _BLOCK, info.size if stated_size is None else stated_size)
    if not 0 <= extent.size <= size - extent.start:
        raise ArchiveError("archive_cut_off")
    return info.name, extent


def _parsed(header: bytes) -> tarfile.TarInfo:
    try:
        return tarfile.TarInfo.frombuf(header, "utf-8", "surrogateescape")
    except (tarfile.HeaderError, ValueError) as error:
        raise ArchiveError("archive_not_tar") from error


def _stated_size(extended: bytes) -> int | None:
    """The size of the member in an extended header, where one is stated: lines of LENGTH, a space, KEY=VALUE
    (POSIX.1-2001, pax). Raises ArchiveError where it states a path, holes or anything else unexpected."""
    size = None
    while extended:
        found = _RECORD.match(extended)
        length = int(found[1]) if found else 0
        if not found or found[2].decode() not in _EXTENDED or not found.end() < length <= len(extended):
            raise ArchiveError("archive_foreign")
        value, extended = extended[found.end() : length - 1], extended[length:]
        if found[2] == b"size":
            size = int(value) if re.fullmatch(rb"[0-9]{1,18}", value) else -1
    return size


def _manifest(file: BufferedReader, extent: Extent | None) -> Manifest:
    if extent is None or extent.size > MAX_MANIFEST_BYTES:
        raise ArchiveError("archive_without_manifest")
    try:
        return msgspec.json.decode(b"".join(_chunks(file, extent)), type=Manifest)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise ArchiveError("archive_manifest_damaged") from error


def _next_block(extent: Extent) -> int:
    return extent.start + -(-extent.size // _BLOCK) * _BLOCK


def _read_at(file: BufferedReader, at: int, count: int, size: int) -> bytes:
    if at + count > size:
        raise ArchiveError("archive_cut_off")
    return b"".join(_chunks(file, Extent(at, count)))


def _chunks(file: BufferedReader, extent: Extent) -> Iterator[bytes]:
    """The content of a member, a piece at a time."""
    file.seek(extent.start)
    left = extent.size
    while left:
        chunk = file.read(min(left, _CHUNK))
        if not chunk:
            raise ArchiveError("archive_cut_off")
        yield chunk
        left -= len(chunk)

"""The archive of backup-store, read as a file that anyone may have forged: the known names alone, plain files
alone, every size checked before anything is read. No path of the archive is ever used.

`tarfile` reads the headers, within a bound, and writes nothing: extracting follows what an archive states,
and its filters are not in Python 3.11.2, which Debian 12 ships.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tarfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BufferedIOBase, BufferedReader
from pathlib import Path
from typing import Annotated

import msgspec

from app.audit.archive import NAME as ARCHIVED
from app.audit.archive import digest_of
from app.cli.stores.backup_files import ENCRYPTED, IN_CLEAR, MAX_BYTES
from app.cli.stores.kept_events import FOLDER, copy_file, is_kept, kept_file
from app.database.private import FILE_MODE
from app.database.reserve import free_bytes
from app.errors import StoreError
from app.handover.notes.pictures import FILE as PICTURES
from app.history.service import FILE as HISTORY
from app.settings import STORE_FILE
from bus.errors import LinesideError
from bus.messages import Message, ParamValue

MANIFEST = "manifest.json"
STORES = (HISTORY, STORE_FILE, PICTURES)
"""In the order in which they are copied: a picture is stored before its note, so that each note of the copy
has its pictures."""
MAX_ARCHIVE_BYTES = 256 * 2**30
MAX_MANIFEST_BYTES = 2**18
MAX_HEADER_BYTES = 2**21
"""Of all members together: `tarfile` writes at most 1,536 for each, its time in an extended header. A century
of archived events has 1,200."""
MAX_PADDING_BYTES = 2**20
"""After the last member; GNU tar fills up records of at most 512 kB."""
_EXTENDED = frozenset(("mtime", "atime", "ctime", "size", "uid", "gid", "uname", "gname"))
"""What an extended header may state. It could also give another path, or holes."""
_CHUNK = 2**20
_Digest = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


class ArchiveError(LinesideError):
    """The archive is not one that backup-store writes, for a reason by its code."""

    def __init__(self, code: str, **params: ParamValue) -> None:
        super().__init__(Message(code, params))


class Manifest(msgspec.Struct):
    """``stores``: the SHA-256 of each by its name, hexadecimal; ``files``: the same of the member that has
    the files of the site; ``events``: of each file of archived events that is a member, ``kept_events``: of
    each that is in the folder beside the backups; ``time``: Unix time of the backup."""

    time: Annotated[float, msgspec.Meta(ge=0, lt=2**37)]
    stores: Annotated[dict[str, _Digest], msgspec.Meta(min_length=1)]
    files: Annotated[dict[str, _Digest], msgspec.Meta(max_length=1)] = {}
    events: dict[str, _Digest] = {}
    kept_events: dict[str, _Digest] = {}

    @property
    def digests(self) -> dict[str, str]:
        """Of every other member."""
        return {**self.stores, **self.files, **self.events}

    @property
    def all_events(self) -> dict[str, str]:
        """Of each file of archived events, wherever it is."""
        return {**self.events, **self.kept_events}


@dataclass(frozen=True, slots=True)
class Extent:
    """Where the content of a member is, in bytes."""

    start: int
    size: int


@dataclass(frozen=True, slots=True)
class BackupArchive:
    """An open backup whose members and manifest are as they should be; none is read yet. ``kept``: the folder
    of the archived events that it refers to."""

    file: BufferedReader
    path: Path
    members: Mapping[str, Extent]
    manifest: Manifest
    kept: Path

    @property
    def message(self) -> Message:
        """Its file, when it was taken and its SHA-256, hexadecimal."""
        taken = datetime.fromtimestamp(self.manifest.time, UTC).isoformat(timespec="seconds")
        self.file.seek(0)
        digest = hashlib.file_digest(self.file, "sha256").hexdigest()
        return Message.of("backup_of", file=self.path.name, time=taken, digest=digest)

    def unpack(self, folder: Path) -> list[Path]:
        """Write the stores into an empty folder; each is what was backed up. Raises StoreError."""
        stores = sorted(self.manifest.stores)
        needed, free = sum(self.members[name].size for name in stores), free_bytes(folder)
        if needed > free:
            raise StoreError(Message.of("backup_needs_space", file=str(self.path), needed=needed, free=free))
        return [self._unpack_one(name, folder / name) for name in stores]

    def unpack_events(self, folder: Path) -> list[Path]:
        """Write the archived events that are not in the folder; one that is there stays. Raises StoreError
        where it is another one, OSError. Those kept beside the backup that are missing or damaged are left
        out: the stores come back without."""
        digests = self.manifest.all_events
        places = {name: folder / name for name in sorted(digests)}
        absent = {name: place for name, place in places.items() if not os.path.lexists(place)}
        for name in places.keys() - absent.keys():
            if digest_of(places[name]) != digests[name]:
                raise StoreError(Message.of("backup_archive_differs", file=str(places[name])))
        for name in self.lost_events:
            absent.pop(name, None)
        needed, free = sum(map(self._size_of_events, absent)), free_bytes(folder)
        if needed > free:
            raise StoreError(Message.of("backup_needs_space", file=str(self.path), needed=needed, free=free))
        for name, place in absent.items():
            fresh = place.with_name(f".{name}.restored")
            fresh.unlink(missing_ok=True)
            if name in self.members:
                self._unpack_one(name, fresh)
            else:
                copy_file(kept_file(self.kept, digests[name]), fresh)
                self._compare(name, digest_of(fresh))
            fresh.rename(place)
        return [*absent.values()]

    def _size_of_events(self, name: str) -> int:
        if (extent := self.members.get(name)) is not None:
            return extent.size
        return kept_file(self.kept, self.manifest.kept_events[name]).stat().st_size

    @property
    def lost_events(self) -> list[str]:
        """The files of archived events that it refers to and that are not beside it, or damaged."""
        kept = self.manifest.kept_events
        return sorted(name for name, digest in kept.items() if not is_kept(self.kept, digest))

    def files(self) -> tuple[str, bytes]:
        """The member that has the files of the site: its name and its content. Raises StoreError."""
        for name in self.manifest.files:
            if self.members[name].size > MAX_BYTES:
                raise ArchiveError("archive_too_large", most=MAX_BYTES)
            content = b"".join(_chunks(self.file, self.members[name]))
            self._compare(name, hashlib.sha256(content).hexdigest())
            return name, content
        raise ArchiveError("archive_without_files")

    def verify(self) -> None:
        """Read every member as it is in the file, and what is kept beside it. Raises StoreError where one is
        not what was backed up."""
        for name, extent in self.members.items():
            digest = hashlib.sha256()
            for chunk in _chunks(self.file, extent):
                digest.update(chunk)
            self._compare(name, digest.hexdigest())
        for name in self.lost_events:
            raise self._damaged(name)

    def _compare(self, name: str, digest: str) -> None:
        if digest != {**self.manifest.digests, **self.manifest.kept_events}[name]:
            raise self._damaged(name)

    def _damaged(self, name: str) -> StoreError:
        return StoreError(Message.of("backup_damaged", file=str(self.path), store=name))

    def _unpack_one(self, name: str, place: Path) -> Path:
        digest, flags = hashlib.sha256(), os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        with os.fdopen(os.open(place, flags, FILE_MODE), "wb") as target:
            for chunk in _chunks(self.file, self.members[name]):
                digest.update(chunk)
                target.write(chunk)
        self._compare(name, digest.hexdigest())
        return place


@contextmanager
def open_archive(path: Path, kept: Path | None = None) -> Iterator[BackupArchive]:
    """Open a backup. ``kept``: the folder of the archived events that it refers to, where that is not beside
    it. Raises StoreError for a file that is none."""
    # A FIFO would be waited for.
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as file:
        try:
            yield _read(file, path, kept or path.absolute().parent / FOLDER)
        except ArchiveError as error:
            raise StoreError(Message.of("backup_malformed", file=str(path), error=error.message)) from error


def _read(file: BufferedReader, path: Path, kept: Path) -> BackupArchive:
    found = os.fstat(file.fileno())
    if not stat.S_ISREG(found.st_mode):
        raise ArchiveError("archive_not_regular")
    if found.st_size > MAX_ARCHIVE_BYTES:
        raise ArchiveError("archive_too_large", most=MAX_ARCHIVE_BYTES)
    members = _members(file, found.st_size)
    manifest = _manifest(file, members.pop(MANIFEST, None))
    is_named = manifest.stores.keys() <= {*STORES} and all(map(ARCHIVED.fullmatch, manifest.all_events))
    is_twice = not manifest.events.keys().isdisjoint(manifest.kept_events)
    if manifest.digests.keys() != members.keys() or not is_named or is_twice:
        raise ArchiveError("archive_manifest_differs")
    return BackupArchive(file, path, members, manifest, kept)


def _members(file: BufferedReader, size: int) -> dict[str, Extent]:
    """By name where each member is, none beyond the end of the file, which is ``size``."""
    members: dict[str, Extent] = {}
    try:
        with tarfile.TarFile(fileobj=_Headers(file)) as archive:
            for info in archive:
                _check(info, archive.pax_headers)
                if not 0 <= info.size <= size - info.offset_data:
                    raise ArchiveError("archive_cut_off")
                if info.name in members:
                    raise ArchiveError("archive_holds_twice", name=info.name)
                members[info.name] = Extent(info.offset_data, info.size)
            end = archive.offset
    except (tarfile.TarError, ValueError, RecursionError) as error:
        raise ArchiveError("archive_not_tar") from error
    file.seek(end)
    last = file.read(tarfile.BLOCKSIZE)
    if len(last) < tarfile.BLOCKSIZE:
        raise ArchiveError("archive_cut_off")
    if any(last):
        raise ArchiveError("archive_not_tar")
    if size - end > MAX_PADDING_BYTES:
        raise ArchiveError("archive_goes_on")
    return members


def _check(info: tarfile.TarInfo, of_all: Mapping[str, str]) -> None:
    """Raises ArchiveError for a member that backup-store does not write. ``of_all``: what a header states for
    all members."""
    is_plain = info.type in (tarfile.REGTYPE, tarfile.AREGTYPE) and info.sparse is None
    is_known = info.name in (MANIFEST, *STORES, IN_CLEAR, ENCRYPTED) or ARCHIVED.fullmatch(info.name)
    if of_all or not is_plain or not is_known or info.pax_headers.keys() - _EXTENDED:
        raise ArchiveError("archive_foreign")


class _Headers(BufferedIOBase):
    """The file as `tarfile` reads headers in it, which can never be more than a few: a forged one may state
    any length, and `tarfile` would follow."""

    def __init__(self, file: BufferedReader) -> None:
        self._file = file
        self._left = MAX_HEADER_BYTES

    def seek(self, place: int, whence: int = os.SEEK_SET) -> int:
        return self._file.seek(place, whence)

    def read(self, count: int | None = -1) -> bytes:
        if count is None or not 0 <= count <= self._left:
            raise ArchiveError("archive_header_too_large")
        self._left -= count
        return self._file.read(count)


def _manifest(file: BufferedReader, extent: Extent | None) -> Manifest:
    if extent is None or extent.size > MAX_MANIFEST_BYTES:
        raise ArchiveError("archive_without_manifest")
    try:
        return msgspec.json.decode(b"".join(_chunks(file, extent)), type=Manifest)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise ArchiveError("archive_manifest_damaged") from error


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

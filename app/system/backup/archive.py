"""A backup in one file, a tar archive, read as a file that anyone may have forged: the known names alone,
plain files alone, every size checked before anything is read. No path of the archive is ever used.

`tarfile` reads the headers, within a bound, and writes nothing: extracting follows what an archive states,
and its filters are not in Python 3.11.2, which Debian 12 ships.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BufferedIOBase, BufferedReader
from pathlib import Path

import msgspec

from app.core.database.files import free_bytes, in_words, make_file, sync_folder, write_file
from app.errors import StoreError
from app.people.audit.archive import NAME as ARCHIVED
from app.people.audit.archive import digest_of
from app.settings import STORE_FILE
from app.system.backup.backup import (
    Backup,
    BackupError,
    Manifest,
    WrittenBackup,
    chunks_of,
    decode_manifest,
    open_plain,
)
from app.system.backup.files import ENCRYPTED, IN_CLEAR, SiteFiles
from app.system.backup.stores import STORES, archived_in, copy_store
from app.version import VERSION
from bus.instants import unix_now
from bus.messages import Message

MANIFEST = "manifest.json"
KEPT_EVENTS = "archived-events"
"""The folder beside an archive of version 0.2 in which archived events were kept, by their SHA-256."""
WORKING = ".lineside-backup-"
"""Begins the name of the folder in which an archive is made."""
MAX_ARCHIVE_BYTES = 256 * 2**30
MAX_MANIFEST_BYTES = 2**18
MAX_HEADER_BYTES = 2**21
"""Of all members together: `tarfile` writes at most 1,536 for each, its time in an extended header. A century
of archived events has 1,200."""
MAX_PADDING_BYTES = 2**20
"""After the last member; GNU tar fills up records of at most 512 kB."""
_EXTENDED = frozenset(("mtime", "atime", "ctime", "size", "uid", "gid", "uname", "gname"))
"""What an extended header may state. It could also give another path, or holes."""


@dataclass(frozen=True, slots=True)
class Extent:
    """Where the content of a member is, in bytes."""

    start: int
    size: int


class BackupArchive(Backup):
    """An open archive whose members are those of its manifest."""

    def __init__(
        self, file: BufferedReader, path: Path, members: Mapping[str, Extent], manifest: Manifest
    ) -> None:
        super().__init__(path, manifest)
        self._file, self._members = file, members

    def size_of(self, name: str) -> int:
        extent = self._members.get(name)
        return self._kept(name).stat().st_size if extent is None else extent.size

    def chunks(self, name: str) -> Iterator[bytes]:
        if (extent := self._members.get(name)) is not None:
            self._file.seek(extent.start)
            yield from chunks_of(self._file, extent.size)
            return
        with open_plain(self._kept(name)) as file:
            yield from chunks_of(file, os.fstat(file.fileno()).st_size)

    def _kept(self, name: str) -> Path:
        return self.path.absolute().parent / KEPT_EVENTS / f"{self.manifest.kept_events[name]}.jsonl.gz"


@contextmanager
def open_archive(path: Path) -> Iterator[BackupArchive]:
    """Open an archive. Raises StoreError for a file that is none."""
    try:
        with open_plain(path.resolve()) as file:
            yield _read(file, path)
    except BackupError as error:
        raise StoreError(Message.of("backup_malformed", file=str(path), error=error.message)) from error


def write_archive(data: Path, file: Path, files: SiteFiles | None, archive: Path | None) -> WrittenBackup:
    """Copy the stores of a data folder, the files of its site, and the archived events of its log into one
    file. Raises StoreError, also where a store or a file of the archive is damaged: it could not be put back;
    then there is no file."""
    present = [name for name in STORES if (data / name).exists()]
    if not present:
        raise StoreError(Message.of("stores_missing", folder=str(data)))
    if file.exists():
        raise StoreError(Message.of("backup_exists", file=str(file)))
    with in_words(file), _working_folder(file.absolute().parent) as folder:
        needed = 2 * sum((data / name).stat().st_size for name in present)
        if needed > (free := free_bytes(folder)):
            raise StoreError(Message.of("backup_disk_full", file=str(file), needed=needed, free=free))
        contents = {name: folder / name for name in present}
        for name, place in contents.items():
            copy_store(data / name, place)
        stores = {name: digest_of(place) for name, place in contents.items()}
        events = archived_in(contents[STORE_FILE]) if STORE_FILE in contents else {}
        absent = sorted(name for name in events if archive is None or not (archive / name).is_file())
        for name in events.keys() - absent:
            # A month may be a link to another disk.
            contents[name] = (archive or Path()).joinpath(name).resolve()
            if digest_of(contents[name]) != events[name]:
                raise StoreError(Message.of("audit_archive_altered", file=name))
        events = {name: digest for name, digest in events.items() if name in contents}
        of_files = {}
        if files is not None:
            contents[files.member] = folder / files.member
            write_file(contents[files.member], files.content)
            of_files = {files.member: digest_of(contents[files.member])}
        manifest = Manifest(float(unix_now()), stores, VERSION, of_files, events)
        write_file(folder / MANIFEST, msgspec.json.encode(manifest))
        complete = folder / "complete.tar"
        make_file(complete)
        with complete.open("wb") as target:
            with tarfile.open(fileobj=target, mode="w") as packed:
                for name, content in {MANIFEST: folder / MANIFEST, **contents}.items():
                    packed.add(content, name)
            target.flush()
            os.fsync(target.fileno())
        with open_archive(complete) as written:
            written.verify()
        if file.exists():
            raise StoreError(Message.of("backup_exists", file=str(file)))
        complete.rename(file)
        sync_folder(file.absolute().parent)
    left_out = [] if files is None else files.left_out
    return WrittenBackup(str(file), present, sorted(events), absent, left_out)


@contextmanager
def _working_folder(beside: Path) -> Iterator[Path]:
    """Make a folder on the disk of the backup, which is locked while it is used: one whose process was killed
    is known by that, and removed by the next backup."""
    for left in beside.glob(f"{WORKING}*"):
        with suppress(OSError), locked(left, fcntl.LOCK_EX | fcntl.LOCK_NB):
            shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=WORKING, dir=beside) as name, locked(Path(name)):
        yield Path(name)


@contextmanager
def locked(folder: Path, how: int = fcntl.LOCK_EX) -> Iterator[None]:
    """Hold the lock of a folder, which ends with the process. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, how)
        yield
    finally:
        os.close(descriptor)


def _read(file: BufferedReader, path: Path) -> BackupArchive:
    size = os.fstat(file.fileno()).st_size
    if size > MAX_ARCHIVE_BYTES:
        raise BackupError("archive_too_large", most=MAX_ARCHIVE_BYTES)
    members = _members(file, size)
    extent = members.pop(MANIFEST, None)
    if extent is None or extent.size > MAX_MANIFEST_BYTES:
        raise BackupError("archive_without_manifest")
    file.seek(extent.start)
    manifest = decode_manifest(b"".join(chunks_of(file, extent.size)))
    if manifest.digests.keys() - manifest.kept_events.keys() != members.keys() or manifest.parts:
        raise BackupError("archive_manifest_differs")
    return BackupArchive(file, path, members, manifest)


def _members(file: BufferedReader, size: int) -> dict[str, Extent]:
    """Return by name where each member is, none beyond the end of the file, which is ``size``."""
    members: dict[str, Extent] = {}
    try:
        with tarfile.TarFile(fileobj=_Headers(file)) as archive:
            for info in archive:
                _check(info, archive.pax_headers)
                if not 0 <= info.size <= size - info.offset_data:
                    raise BackupError("archive_cut_off")
                if info.name in members:
                    raise BackupError("archive_holds_twice", name=info.name)
                members[info.name] = Extent(info.offset_data, info.size)
            end = archive.offset
    except (tarfile.TarError, ValueError, RecursionError) as error:
        raise BackupError("archive_not_tar") from error
    file.seek(end)
    last = file.read(tarfile.BLOCKSIZE)
    if len(last) < tarfile.BLOCKSIZE:
        raise BackupError("archive_cut_off")
    if any(last):
        raise BackupError("archive_not_tar")
    if size - end > MAX_PADDING_BYTES:
        raise BackupError("archive_goes_on")
    return members


def _check(info: tarfile.TarInfo, of_all: Mapping[str, str]) -> None:
    """Raises BackupError for a member that no backup has. ``of_all``: what a header states for all
    members."""
    is_plain = info.type in (tarfile.REGTYPE, tarfile.AREGTYPE) and info.sparse is None
    is_known = info.name in (MANIFEST, *STORES, IN_CLEAR, ENCRYPTED) or ARCHIVED.fullmatch(info.name)
    if of_all or not is_plain or not is_known or info.pax_headers.keys() - _EXTENDED:
        raise BackupError("archive_foreign")


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
            raise BackupError("archive_header_too_large")
        self._left -= count
        return self._file.read(count)

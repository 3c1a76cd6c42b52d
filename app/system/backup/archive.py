"""The reading of a backup, from one file or from a folder of backups. Anyone may have forged it.

Each content is compared with its SHA-256 in the manifest. Of a tar archive only the known names and plain
files are read, and every size is checked before anything is read; no path of the archive is ever used.
`tarfile` reads the headers, within a limit, and writes nothing: extracting follows the statements of an
archive, and its filters are not in Python 3.11.2, which Debian 12 ships.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import stat
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BufferedIOBase, BufferedReader
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec

from app.core.database.files import FILE_MODE, free_bytes, in_words, make_file, sync_folder, write_file
from app.errors import StoreError
from app.people.audit.archive import NAME as ARCHIVED
from app.people.audit.archive import digest_of
from app.settings import STORE_FILE
from app.system.backup.stores import (
    ENCRYPTED,
    IN_CLEAR,
    MAX_BYTES,
    STORES,
    SiteFiles,
    archived_in,
    copy_store,
)
from app.version import VERSION
from bus.errors import LinesideError
from bus.instants import unix_now
from bus.messages import Message, ParamValue

_CHUNK = 2**20
Digest = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
EMPTY = hashlib.sha256().hexdigest()
"""The digest of a part without rows, for which there is no file."""


class BackupError(LinesideError):
    """Raised for a backup that Lineside did not write, with a reason by its code."""

    def __init__(self, code: str, **params: ParamValue) -> None:
        super().__init__(Message(code, params))


class Manifest(msgspec.Struct, omit_defaults=True):
    """The contents of a backup, each with its SHA-256: ``stores`` by name (a folder has history and pictures
    as frames and ``parts``, by key, with the version); ``files``: those of the site; ``events``: files of
    archived events; ``kept_events``: those that version 0.2 kept in a folder beside. ``time``: Unix time of
    the backup; ``turn``: number of earlier backups, which rotates the check."""

    time: Annotated[float, msgspec.Meta(ge=0, lt=2**37)]
    stores: Annotated[dict[str, Digest], msgspec.Meta(min_length=1)]
    lineside: str = ""
    files: Annotated[dict[str, Digest], msgspec.Meta(max_length=1)] = {}
    events: dict[str, Digest] = {}
    kept_events: dict[str, Digest] = {}
    parts: dict[str, tuple[str, Digest]] = {}
    site: str = ""
    turn: int = 0

    @property
    def all_events(self) -> dict[str, str]:
        """The digest of each file of archived events, wherever the file is."""
        return {**self.events, **self.kept_events}

    @property
    def digests(self) -> dict[str, str]:
        """The digest of each content that has a name."""
        return {**self.stores, **self.files, **self.all_events}

    @property
    def is_plausible(self) -> bool:
        """Whether the manifest names only contents that a backup can have."""
        is_named = self.stores.keys() <= {*STORES} and all(map(ARCHIVED.fullmatch, self.all_events))
        return is_named and self.events.keys().isdisjoint(self.kept_events)


class WrittenBackup(NamedTuple):
    """The result of writing a backup: the names of its ``stores`` and of the files of archived ``events``;
    ``events_absent``: files missing in the archive; ``left_out``: files of the site for which there is no
    key; ``bytes``: written by this run; ``damaged``: contents that older backups have lost."""

    file: str
    stores: list[str]
    events: list[str]
    events_absent: list[str]
    left_out: list[str]
    bytes: int = 0
    damaged: list[str] = []  # noqa: RUF012


def decode_manifest(content: bytes) -> Manifest:
    """Read a manifest. Raise BackupError."""
    try:
        manifest = msgspec.json.decode(content, type=Manifest)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise BackupError("archive_manifest_damaged") from error
    if not manifest.is_plausible:
        raise BackupError("archive_manifest_differs")
    return manifest


class Backup:
    """An open backup, of which only the manifest has been read."""

    def __init__(self, path: Path, manifest: Manifest) -> None:
        self.path, self.manifest = path, manifest
        self.lost: list[str] = []
        """The parts of history and pictures that :meth:`unpack` left out: missing or damaged."""

    def size_of(self, name: str) -> int:
        """Return the size of a content in bytes. Raise OSError."""
        raise NotImplementedError

    def chunks(self, name: str) -> Iterator[bytes]:
        """Yield a content piece by piece. Raise OSError or BackupError."""
        raise NotImplementedError

    @property
    def message(self) -> Message:
        """The file of the backup, the time of the backup and its SHA-256, hexadecimal."""
        taken = datetime.fromtimestamp(self.manifest.time, UTC).isoformat(timespec="seconds")
        return Message.of("backup_of", file=self.path.name, time=taken, digest=digest_of(self.path))

    def unpack(self, folder: Path) -> list[Path]:
        """Write the stores into an empty folder, as they were backed up. Raise StoreError."""
        stores = sorted(self.manifest.stores)
        self.require_space(sum(map(self.size_of, stores)), folder)
        return [self.unpack_one(name, folder / name) for name in stores]

    def unpack_events(self, folder: Path) -> list[Path]:
        """Write the archived events that the folder lacks; existing files stay. Raise StoreError if an
        existing file differs, or OSError. Files that are missing or damaged in the backup are left out: the
        stores are restored without them."""
        digests = self.manifest.all_events
        places = {name: folder / name for name in sorted(digests)}
        absent = {name: place for name, place in places.items() if not os.path.lexists(place)}
        for name in places.keys() - absent.keys():
            if digest_of(places[name]) != digests[name]:
                raise StoreError(Message.of("backup_archive_differs", file=str(places[name])))
        absent = {name: place for name, place in absent.items() if self._is_sound(name)}
        self.require_space(sum(map(self.size_of, absent)), folder)
        for name, place in absent.items():
            fresh = place.with_name(f".{name}.restored")
            fresh.unlink(missing_ok=True)
            self.unpack_one(name, fresh).rename(place)
        return [*absent.values()]

    def files(self) -> tuple[str, bytes]:
        """Return the files of the site in the backup: their name and content. Raise StoreError."""
        for name in self.manifest.files:
            if self.size_of(name) > MAX_BYTES:
                raise BackupError("archive_too_large", most=MAX_BYTES)
            content = b"".join(self.chunks(name))
            self._compare(name, hashlib.sha256(content).hexdigest())
            return name, content
        raise BackupError("archive_without_files")

    def verify(self) -> None:
        """Read every content that has a name. Raise StoreError if one differs from its digest."""
        for name in self.manifest.digests:
            if not self._is_sound(name):
                raise self._damaged(name)

    def require_space(self, needed: int, folder: Path) -> None:
        """Raise StoreError if the disk of a folder has less space."""
        if needed > (free := free_bytes(folder)):
            raise StoreError(Message.of("backup_needs_space", file=str(self.path), needed=needed, free=free))

    def unpack_one(self, name: str, place: Path) -> Path:
        """Write a content to a new file. Raise StoreError if it differs from its digest."""
        digest, flags = hashlib.sha256(), os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        with os.fdopen(os.open(place, flags, FILE_MODE), "wb") as target:
            for chunk in self.chunks(name):
                digest.update(chunk)
                target.write(chunk)
            target.flush()
            os.fsync(target.fileno())
        self._compare(name, digest.hexdigest())
        return place

    def _is_sound(self, name: str) -> bool:
        digest = hashlib.sha256()
        try:
            for chunk in self.chunks(name):
                digest.update(chunk)
        except (OSError, BackupError):
            return False
        return digest.hexdigest() == self.manifest.digests[name]

    def _compare(self, name: str, digest: str) -> None:
        if digest != self.manifest.digests[name]:
            raise self._damaged(name)

    def _damaged(self, name: str) -> StoreError:
        return StoreError(Message.of("backup_damaged", file=str(self.path), store=name))


def open_plain(path: Path) -> BufferedReader:
    """Open a file. Raise OSError, also for a link, and BackupError for a FIFO, which would block."""
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOFOLLOW), "rb")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise BackupError("archive_not_regular")
    return file


def chunks_of(file: BufferedReader, size: int) -> Iterator[bytes]:
    """Yield ``size`` bytes of a file from its present position. Raise BackupError if it ends earlier."""
    while size:
        chunk = file.read(min(size, _CHUNK))
        if not chunk:
            raise BackupError("archive_cut_off")
        yield chunk
        size -= len(chunk)


MANIFEST = "manifest.json"
KEPT_EVENTS = "archived-events"
"""The folder beside an archive of version 0.2 that kept archived events, by their SHA-256."""
WORKING = ".lineside-backup-"
"""The start of the name of the folder in which an archive is made."""
MAX_ARCHIVE_BYTES = 256 * 2**30
MAX_MANIFEST_BYTES = 2**18
MAX_HEADER_BYTES = 2**21
"""The limit for all members together: `tarfile` writes at most 1,536 for each, with its time in an extended
header. A century of archived events has 1,200 members."""
MAX_PADDING_BYTES = 2**20
"""The limit after the last member; GNU tar fills up records of at most 512 kB."""
_EXTENDED = frozenset(("mtime", "atime", "ctime", "size", "uid", "gid", "uname", "gname"))
"""The allowed keys of an extended header, which could also give another path, or holes."""


@dataclass(frozen=True, slots=True)
class Extent:
    """The place of a member's content, in bytes."""

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
    """Open an archive. Raise StoreError for a file that is not one."""
    try:
        with open_plain(path.resolve()) as file:
            yield _read(file, path)
    except BackupError as error:
        raise StoreError(Message.of("backup_malformed", file=str(path), error=error.message)) from error


def write_archive(data: Path, file: Path, files: SiteFiles | None, archive: Path | None) -> WrittenBackup:
    """Copy the stores of a data folder, the files of its site, and the archived events of its log into one
    file. Raise StoreError, also if a store or a file of the archive is damaged, as it could not be restored;
    then no file is written."""
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
    """Make a folder on the disk of the backup and lock it while it is used: an unlocked folder belongs to a
    killed process, and the next backup removes it."""
    for left in beside.glob(f"{WORKING}*"):
        with suppress(OSError), locked(left, fcntl.LOCK_EX | fcntl.LOCK_NB):
            shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=WORKING, dir=beside) as name, locked(Path(name)):
        yield Path(name)


@contextmanager
def locked(folder: Path, how: int = fcntl.LOCK_EX) -> Iterator[None]:
    """Hold the lock of a folder; it ends with the process. Raise OSError."""
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
    """Return the place of each member by name, none beyond ``size``, the end of the file."""
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
    """Raise BackupError for a member that no backup has. ``of_all``: the header for all members."""
    is_plain = info.type in (tarfile.REGTYPE, tarfile.AREGTYPE) and info.sparse is None
    is_known = info.name in (MANIFEST, *STORES, IN_CLEAR, ENCRYPTED) or ARCHIVED.fullmatch(info.name)
    if of_all or not is_plain or not is_known or info.pax_headers.keys() - _EXTENDED:
        raise BackupError("archive_foreign")


class _Headers(BufferedIOBase):
    """The file from which `tarfile` reads headers, with a limit: a forged header may state any length, and
    `tarfile` would follow it."""

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

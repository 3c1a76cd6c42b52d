"""A backup that is read: what its manifest names, each content compared with its SHA-256. It may be an
archive in one file, or in a folder of backups; either way anyone may have forged it."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator
from datetime import UTC, datetime
from io import BufferedReader
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec

from app.core.database.files import FILE_MODE, free_bytes
from app.errors import StoreError
from app.people.audit.archive import NAME as ARCHIVED
from app.people.audit.archive import digest_of
from app.system.backup.files import MAX_BYTES
from app.system.backup.stores import STORES
from bus.errors import LinesideError
from bus.messages import Message, ParamValue

_CHUNK = 2**20
Digest = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
EMPTY = hashlib.sha256().hexdigest()
"""The digest of a part without rows, for which there is no file."""


class BackupError(LinesideError):
    """A backup is not what Lineside writes, for a reason by its code."""

    def __init__(self, code: str, **params: ParamValue) -> None:
        super().__init__(Message(code, params))


class Manifest(msgspec.Struct, omit_defaults=True):
    """What a backup consists of, each with its SHA-256: ``stores`` by name, of which a folder has history and
    pictures as frames and ``parts`` (by key, with the version); ``files``: those of the site; ``events``:
    files of archived events, ``kept_events``: those that version 0.2 kept in a folder beside. ``time``: Unix
    time of the backup; ``turn``: how many there were before it, for the rotation of the check."""

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
        """The digest of each file of archived events, wherever it is."""
        return {**self.events, **self.kept_events}

    @property
    def digests(self) -> dict[str, str]:
        """The digest of everything that has a name."""
        return {**self.stores, **self.files, **self.all_events}

    @property
    def is_plausible(self) -> bool:
        """Whether the manifest names nothing but what a backup can have."""
        is_named = self.stores.keys() <= {*STORES} and all(map(ARCHIVED.fullmatch, self.all_events))
        return is_named and self.events.keys().isdisjoint(self.kept_events)


class WrittenBackup(NamedTuple):
    """What a backup has: the names of its ``stores`` and of the files of archived ``events``; what it has
    not: ``events_absent``, which are not in the archive, ``left_out``, files of the site for which there is
    no key. ``bytes``: written by this run. ``damaged``: contents that older backups have lost."""

    file: str
    stores: list[str]
    events: list[str]
    events_absent: list[str]
    left_out: list[str]
    bytes: int = 0
    damaged: list[str] = []  # noqa: RUF012


def decode_manifest(content: bytes) -> Manifest:
    """Read a manifest. Raises BackupError."""
    try:
        manifest = msgspec.json.decode(content, type=Manifest)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise BackupError("archive_manifest_damaged") from error
    if not manifest.is_plausible:
        raise BackupError("archive_manifest_differs")
    return manifest


class Backup:
    """An open backup, of which nothing but the manifest is read yet."""

    def __init__(self, path: Path, manifest: Manifest) -> None:
        self.path, self.manifest = path, manifest
        self.lost: list[str] = []
        """Parts of history and pictures that :meth:`unpack` left out, as they were missing or damaged."""

    def size_of(self, name: str) -> int:
        """Return the bytes of a content. Raises OSError."""
        raise NotImplementedError

    def chunks(self, name: str) -> Iterator[bytes]:
        """Yield a content, a piece at a time. Raises OSError, BackupError."""
        raise NotImplementedError

    @property
    def message(self) -> Message:
        """Return the file of the backup, when it was taken and its SHA-256, hexadecimal."""
        taken = datetime.fromtimestamp(self.manifest.time, UTC).isoformat(timespec="seconds")
        return Message.of("backup_of", file=self.path.name, time=taken, digest=digest_of(self.path))

    def unpack(self, folder: Path) -> list[Path]:
        """Write the stores into an empty folder; each is what was backed up. Raises StoreError."""
        stores = sorted(self.manifest.stores)
        self.require_space(sum(map(self.size_of, stores)), folder)
        return [self.unpack_one(name, folder / name) for name in stores]

    def unpack_events(self, folder: Path) -> list[Path]:
        """Write the archived events that are not in the folder; one that is there stays. Raises StoreError
        where it is another one, OSError. Those that are missing or damaged in the backup are left out: the
        stores come back without."""
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
        """Return the files of the site in the backup: their name and the content. Raises StoreError."""
        for name in self.manifest.files:
            if self.size_of(name) > MAX_BYTES:
                raise BackupError("archive_too_large", most=MAX_BYTES)
            content = b"".join(self.chunks(name))
            self._compare(name, hashlib.sha256(content).hexdigest())
            return name, content
        raise BackupError("archive_without_files")

    def verify(self) -> None:
        """Read everything that has a name. Raises StoreError where something is not what was backed up."""
        for name in self.manifest.digests:
            if not self._is_sound(name):
                raise self._damaged(name)

    def require_space(self, needed: int, folder: Path) -> None:
        """Raises StoreError where the disk of a folder has less."""
        if needed > (free := free_bytes(folder)):
            raise StoreError(Message.of("backup_needs_space", file=str(self.path), needed=needed, free=free))

    def unpack_one(self, name: str, place: Path) -> Path:
        """Write a content to where no file is. Raises StoreError where it is not what was backed up."""
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
    """Open a file. Raises OSError, also for a link, and BackupError for a FIFO, which would be waited for."""
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOFOLLOW), "rb")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise BackupError("archive_not_regular")
    return file


def chunks_of(file: BufferedReader, size: int) -> Iterator[bytes]:
    """Yield so many bytes of a file from its present position. Raises BackupError where it ends before."""
    while size:
        chunk = file.read(min(size, _CHUNK))
        if not chunk:
            raise BackupError("archive_cut_off")
        yield chunk
        size -= len(chunk)

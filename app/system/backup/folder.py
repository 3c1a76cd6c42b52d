"""A folder of backups of one site, and their schedule.

The folder has a manifest for each backup, and every content once, under its SHA-256. A backup writes the
contents that the folder does not have, syncs and reads back each of them, and only then puts its manifest
into the folder under its name: an unfinished backup has no manifest. No content ever changes, so backups
share contents, and each backup is complete on its own.

The clock may have been changed by a year, in either direction, since any of the backups.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime, time, timedelta, tzinfo
from pathlib import Path
from zoneinfo import ZoneInfo

import msgspec

from app.core.database.connection import examining, open_for_reading, snapshot
from app.core.database.files import (
    free_bytes,
    fresh_file,
    in_words,
    make_file,
    make_folder,
    refuse_link,
    sync_folder,
    write_file,
)
from app.core.database.migration import COMPANIONS
from app.errors import StoreError
from app.people.audit.archive import digest_of
from app.settings import STORE_FILE, Settings
from app.system.backup.archive import (
    EMPTY,
    KEPT_EVENTS,
    Backup,
    BackupError,
    Manifest,
    WrittenBackup,
    chunks_of,
    decode_manifest,
    locked,
    open_plain,
)
from app.system.backup.settings import BackupSettings
from app.system.backup.stores import (
    KINDS,
    TAKEN_APART,
    archived_in,
    assemble,
    copy_store,
    export_frame,
    files_of,
    parts_of,
    site_of,
)
from app.version import VERSION
from bus.instants import DAY_S, HOUR_S, UnixTime
from bus.messages import Message

FORMAT = "lineside-%Y%m%dT%H%M%SZ.json"
"""The name of a backup's manifest, by UTC."""
ARCHIVE = re.compile(r"lineside-(\d{4}-\d{2}-\d{2}-\d{6})\.tar")
"""The name of a backup of version 0.2, by the clock of the site."""
RETRY_S = 3600.0
"""The delay after a failed backup; it is shorter if backups are more frequent."""
ALL_S = 2 * HOUR_S
"""The time for which every backup is kept; then one per hour of a day, one per day of ``keep`` days, then one
per month."""
MONTHS = 12


def next_after(now: UnixTime, at: str, zone: ZoneInfo) -> UnixTime:
    """Return the next moment after ``now`` at which the clock of the zone shows ``at``; on a day without it,
    the moment at which it would."""
    local = datetime.fromtimestamp(float(now), zone)
    due = datetime.combine(local.date(), time.fromisoformat(at), zone)
    while due.timestamp() <= float(now):
        due = datetime.combine(due.date() + timedelta(days=1), due.time(), zone)
    return UnixTime(due.timestamp())


def next_due(
    now: UnixTime, newest: UnixTime | None, failed: UnixTime | None, settings: BackupSettings, zone: ZoneInfo
) -> UnixTime:
    """Return when the next backup is due; not after ``now`` if one should begin. ``newest``: the start of the
    newest backup, None if there is none; ``failed``: the start of the last attempt, None if it succeeded. A
    time in the future comes from a wrong clock and does not count."""
    every = settings.every_s
    if newest is None or newest > now:
        due = now
    else:
        due = next_after(newest, settings.at, zone) if every is None else newest + every
    retry_s = RETRY_S if every is None else min(RETRY_S, every)
    return due if failed is None or failed > now else max(due, failed + retry_s)


def name_of(at: UnixTime) -> str:
    """Return the name of a backup's manifest by its start; later backups sort after it."""
    return datetime.fromtimestamp(float(at), UTC).strftime(FORMAT)


def time_of(name: str, zone: tzinfo = UTC) -> UnixTime | None:
    """Return the start of a backup by its name; None for another file."""
    try:
        if (archive := ARCHIVE.fullmatch(name)) is not None:
            local = datetime.strptime(archive[1], "%Y-%m-%d-%H%M%S").replace(tzinfo=zone)
        else:
            local = datetime.strptime(name, FORMAT).replace(tzinfo=UTC)
    except ValueError:
        return None
    return UnixTime(local.timestamp())


def too_many(names: Iterable[str], keep: int, written: str, zone: ZoneInfo) -> list[str]:
    """Return the files of a folder that are backups but not to be kept. ``written``, the backup just written,
    is the newest: those with a later date come from a wrong clock."""
    times = {name: at for name in names if (at := time_of(name, zone)) is not None}
    now = times[written]
    past = sorted((name for name, at in times.items() if at <= now), key=times.__getitem__, reverse=True)

    def first_of(key: Callable[[datetime], tuple[int, ...]], most: int) -> set[str]:
        """Return the newest backup of each of the ``most`` newest periods."""
        found: dict[tuple[int, ...], str] = {}
        for name in past:
            found.setdefault(key(datetime.fromtimestamp(float(times[name]), zone)), name)
        return {*[*found.values()][:most]}

    kept = {name for name in past if now - times[name] <= ALL_S} | {written}
    hourly = first_of(lambda local: (local.toordinal(), local.hour), 10**6)
    kept |= {name for name in hourly if now - times[name] <= DAY_S}
    kept |= first_of(lambda local: (local.toordinal(),), keep)
    kept |= first_of(lambda local: (local.year, local.month), MONTHS)
    return sorted(times.keys() - kept)


SITE, CONTENTS = "lineside-site.json", "contents"
FULL_CHECK_S = 28 * 86_400.0
"""The time in which the rotation has read every content again."""
REMOVE_EVERY = 6
"""The number of backups between two removals of unnamed contents, which read every manifest."""
MARGIN = 10_000_000
"""The bytes that a backup takes besides the main store, if the folder has the rest."""


class _Site(msgspec.Struct):
    site: str
    name: str = ""


class FolderBackup(Backup):
    """A backup in a folder, by its manifest."""

    def __init__(self, path: Path) -> None:
        with open_plain(path) as file:
            content = file.read()
        super().__init__(path, decode_manifest(content))
        self._contents = path.absolute().parent / CONTENTS

    def size_of(self, name: str) -> int:
        return (self._contents / self.manifest.digests[name]).stat().st_size

    def chunks(self, name: str) -> Iterator[bytes]:
        with open_plain(self._contents / self.manifest.digests[name]) as file:
            yield from chunks_of(file, os.fstat(file.fileno()).st_size)

    def unpack(self, folder: Path) -> list[Path]:
        """Put frames and parts together. A missing or damaged part is left out; the others are restored."""
        self.require_space(sum(map(self._size, self._parts())), folder)
        unpacked = super().unpack(folder)
        for store in unpacked:
            if store.name in TAKEN_APART:
                frame = store.rename(store.with_name(f".{store.name}.frame"))
                make_file(store)
                assemble(frame, self._sound_parts(store.name), store)
                frame.unlink()
        return unpacked

    def _parts(self, store: str = "") -> Iterator[tuple[str, Path]]:
        for key, (_, digest) in self.manifest.parts.items():
            kind = KINDS.get(key.partition("-")[0])
            if kind is not None and store in ("", kind.store) and digest != EMPTY:
                yield key, self._contents / digest

    @staticmethod
    def _size(part: tuple[str, Path]) -> int:
        with suppress(OSError):
            return part[1].stat().st_size
        return 0

    def _sound_parts(self, store: str) -> Iterator[tuple[str, Path]]:
        for key, place in self._parts(store):
            if is_sound(place):
                yield key, place
            else:
                self.lost.append(key)


def is_sound(content: Path) -> bool:
    """Return whether a content has the SHA-256 that is its name. A FIFO or a link in its place is not
    read."""
    with suppress(OSError, BackupError), open_plain(content) as file:
        return hashlib.file_digest(file, "sha256").hexdigest() == content.name
    return False


def manifests_in(folder: Path) -> list[Path]:
    """Return the backups of a folder, newest first. Raise StoreError for a folder that cannot be read."""
    with in_words(folder):
        names = [path for path in folder.iterdir() if path.suffix == ".json" and time_of(path.name)]
    return sorted(names, reverse=True)


def open_newest(folder: Path, until: UnixTime | None = None) -> FolderBackup:
    """Open the newest readable backup of a folder, or the newest that began by a time. Raise StoreError if
    there is none."""
    for path in manifests_in(folder):
        if until is None or (time_of(path.name) or until) <= until:
            with suppress(OSError, BackupError):
                return FolderBackup(path)
    raise StoreError(Message.of("backup_none_in_folder", folder=str(folder)))


def refuse_other_site(folder: Path, store: Path) -> str:
    """Return the identity of the site of a main store. Raise StoreError for a folder with the backups of
    another site, and for a store of an earlier version."""
    with examining(store) as connection:
        site = site_of(connection)
    if site is None:
        raise StoreError(Message.of("store_of_earlier_version", path=str(store)))
    with suppress(FileNotFoundError):
        try:
            found = msgspec.json.decode((folder / SITE).read_bytes(), type=_Site)
        except (msgspec.MsgspecError, ValueError) as error:
            raise StoreError(Message.of("backup_folder_malformed", file=str(folder / SITE))) from error
        if found.site != site:
            raise StoreError(
                Message.of("backup_folder_of_other_site", folder=str(folder), site=found.name or "?")
            )
    return site


def space_needed(settings: Settings, folder: Path) -> int:
    """Return the bytes that the next backup takes on the disk of a folder: the main store; all data for the
    first backup."""
    data, names = settings.server.data, [STORE_FILE]
    files: list[Path] = []
    if not (folder / CONTENTS).is_dir():
        names += TAKEN_APART
        files += settings.audit.archive.glob("events-*.jsonl.gz") if settings.audit.archive else []
    files += (data / f"{name}{suffix}" for name in names for suffix in ("", *COMPANIONS))
    return sum(file.stat().st_size for file in files if file.exists()) + MARGIN


def write_to_folder(settings: Settings, folder: Path, now: UnixTime) -> WrittenBackup:
    """Add a backup to a folder, and remove the excess ones. Raise StoreError; then no backup is added."""
    if not folder.is_dir():
        # The folder is not created: it may belong to a disk that is not mounted.
        raise StoreError(Message.of("backup_folder_missing", folder=str(folder)))
    if not settings.server.store.exists():
        raise StoreError(Message.of("stores_missing", folder=str(settings.server.data)))
    with in_words(folder), _alone(folder):
        return _Run(settings, folder, now).write()


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Let only one backup run at a time: another could remove contents that this one is about to name. Remove
    the remains of a killed run."""
    contents = folder / CONTENTS
    refuse_link(contents)
    make_folder(contents)
    with locked(contents):
        for left in (*contents.glob(".*"), *folder.glob(".lineside-*.json.*")):
            left.unlink()
        yield


class _Run:
    """A backup that is being written."""

    def __init__(self, settings: Settings, folder: Path, now: UnixTime) -> None:
        self._settings, self._folder, self._now = settings, folder, now
        self._zone = ZoneInfo(settings.site.zone)
        self._contents = folder / CONTENTS
        self._names = {entry.name for entry in os.scandir(self._contents)}
        self._written: dict[str, int] = {}
        try:
            former = open_newest(folder).manifest
            self._former, self._turn = former.parts, former.turn + 1
        except StoreError:
            self._former, self._turn = {}, 0

    def write(self) -> WrittenBackup:
        store = self._settings.server.store
        site, files = refuse_other_site(self._folder, store), files_of(self._settings)
        if not (self._folder / SITE).exists():
            site_file = _Site(site, self._settings.site.name)
            write_file(self._folder / SITE, msgspec.json.encode(site_file))
        self._make_room()
        damaged = self._check_some()
        parts: dict[str, tuple[str, str]] = {}
        main, copy = self._main_store(store)
        stores = {STORE_FILE: main, **{name: self._take_apart(name, parts) for name in TAKEN_APART}}
        events, absent = self._events(copy)
        manifest = Manifest(
            time=float(self._now),
            stores={name: digest for name, digest in stores.items() if digest},
            lineside=VERSION,
            files={files.member: self._put(files.content)},
            events=events,
            parts=parts,
            site=site,
            turn=self._turn,
        )
        name = self._finish(manifest)
        self._thin(name)
        # Contents that this run has written again are sound for every backup.
        lost = sorted(digest for digest in damaged if digest not in self._names)
        return WrittenBackup(
            name, [*manifest.stores], [*events], absent, files.left_out, sum(self._written.values()), lost
        )

    def _make_room(self) -> None:
        needed = space_needed(self._settings, self._folder)
        if free_bytes(self._folder) < needed:
            self._remove_unnamed()
        if (free := free_bytes(self._folder)) < needed:
            raise StoreError(Message.of("backup_disk_full", file=str(self._folder), needed=needed, free=free))

    def _check_some(self) -> list[str]:
        """Read a part of the contents, another part each time. Remove damaged ones: they are written again if
        the store still has them."""
        slices = max(1, int(FULL_CHECK_S / (self._settings.backup.every_s or 86_400.0)))
        mine = [name for name in self._names if int(name[:8], 16) % slices == self._turn % slices]
        damaged = [name for name in mine if not is_sound(self._contents / name)]
        for name in damaged:
            (self._contents / name).unlink()
            self._names.remove(name)
        return damaged

    def _take_apart(self, name: str, parts: dict[str, tuple[str, str]]) -> str:
        """Add the parts of a store, exporting those that changed; return the digest of its frame, empty if
        there is no store."""
        path = self._settings.server.data / name
        if not path.exists():
            return ""
        with in_words(path), closing(open_for_reading(path)) as store, snapshot(store):
            for part in parts_of(name, store, self._now):
                version, digest = self._former.get(part.key, ("", ""))
                if version != part.version or digest not in (*self._names, EMPTY):
                    digest = self._put(part.export(store))
                parts[part.key] = part.version, digest
            return self._put(export_frame(name, store))

    def _main_store(self, store: Path) -> tuple[str, Path]:
        """Copy the main store; return the digest and the place of the copy."""
        fresh = self._contents / ".store"
        copy_store(store, fresh)
        digest = digest_of(fresh)
        self._written[digest] = fresh.stat().st_size
        self._names.add(digest)
        return digest, fresh.rename(self._contents / digest)

    def _events(self, copy: Path) -> tuple[dict[str, str], list[str]]:
        """Return the digest of each archived file of a copied log, and the names of those missing in the
        archive. Archived files never change, and the copy names no later ones. Raise StoreError for a damaged
        file."""
        archive, found, absent = self._settings.audit.archive, {}, []
        for name, digest in archived_in(copy).items():
            if digest not in self._names and (archive is None or not (archive / name).is_file()):
                absent.append(name)
                continue
            if digest not in self._names:
                assert archive is not None
                if self._put((archive / name).read_bytes()) != digest:
                    raise StoreError(Message.of("audit_archive_altered", file=name))
            found[name] = digest
        return found, absent

    def _put(self, content: bytes) -> str:
        digest = hashlib.sha256(content).hexdigest()
        if digest not in self._names and content:
            with fresh_file(self._contents / digest[:8], content) as fresh:
                fresh.rename(self._contents / digest)
            self._names.add(digest)
            self._written[digest] = len(content)
        return digest

    def _finish(self, manifest: Manifest) -> str:
        """Read back the written contents, then put the manifest in its place. Raise StoreError."""
        sync_folder(self._contents)
        for digest in self._written:
            if not is_sound(self._contents / digest):
                raise StoreError(Message.of("backup_damaged", file=str(self._folder), store=digest))
        content, place = msgspec.json.encode(manifest), self._folder / name_of(self._now)
        self._written[place.name] = len(content)
        write_file(place, content)
        if place.read_bytes() != content:
            raise StoreError(Message.of("backup_damaged", file=str(place), store=place.name))
        return place.name

    def _thin(self, written: str) -> None:
        names = [path.name for path in self._folder.iterdir()]
        for name in too_many(names, self._settings.backup.keep, written, self._zone):
            (self._folder / name).unlink(missing_ok=True)
        if self._turn % REMOVE_EVERY == 0:
            self._remove_unnamed()

    def _remove_unnamed(self) -> None:
        """Delete the contents that no backup names, unless a backup cannot be read."""
        named = set(self._written)
        for path in manifests_in(self._folder):
            try:
                manifest = FolderBackup(path).manifest
            except (OSError, BackupError):
                return
            named.update(manifest.digests.values(), (digest for _, digest in manifest.parts.values()))
        for name in self._names - named:
            (self._contents / name).unlink(missing_ok=True)
        self._names &= named
        if not any(self._folder.glob("*.tar")):
            shutil.rmtree(self._folder / KEPT_EVENTS, ignore_errors=True)
